"""Nothing given gives nothing, and what goes through Dr.Jit comes back as it was."""

import inspect
import subprocess
import sys
from dataclasses import fields, is_dataclass

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.arrays import by_rows, in_own_memory, to_numpy, to_scalars, to_vectors
from virtual_sensor.engine import dr, mi
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.optics.newton_search import newton_along_line
from virtual_sensor.optics.projection import projected_points
from virtual_sensor.optics.sensitivity import laser_y_at, line_sensitivity
from virtual_sensor.optics.sight import incidence_points, misses, seen_points
from virtual_sensor.studies.field_info import inside_part

NONE = np.zeros(0)
POINTS, PIXELS = np.zeros((0, 3)), np.zeros((0, 2))
HOT = load_scene("hot_cylinder", width=64, height=64)
LENS = vs.Lens(75.0, 300.0, 3.75)
PROJECTED = load_scene("fringe_cylinder", width=64, height=64)
CAMERA, PROJECTOR = PROJECTED.camera, PROJECTED.projector.family

EMPTY = {
    "air_refractivity": lambda: vs.air_refractivity(532.0, NONE),
    "projected_points": lambda: projected_points(HOT, []),
    "triangulated_points": lambda: vs.triangulated_points(HOT, []),
    "ray_search": lambda: vs.ray_search(HOT, NONE),
    "ray_search, of a list, by Newton": lambda: vs.ray_search(HOT, [], "newton"),
    "ray_search, by maps": lambda: vs.ray_search(HOT, NONE, "tabulated"),
    "ray_search, of a projector": lambda: vs.ray_search(PROJECTED, projector_pixel=[]),
    "pupil_search": lambda: vs.pupil_search(HOT, NONE, lens=LENS, points=2).pixel,
    "circle_of_confusion_px": lambda: vs.circle_of_confusion_px(HOT, POINTS, lens=LENS),
    "projector_pixels": lambda: vs.projector_pixels(PROJECTED, PIXELS),
    "epipolar_residual": lambda: vs.epipolar_residual(CAMERA, PROJECTOR, [], PIXELS),
    "project": lambda: vs.project(HOT, POINTS),
    "project, of a list, straight": lambda: vs.project(HOT, [], through_medium=False),
    "projected_points, by Newton": lambda: projected_points(HOT, POINTS, method="newton"),
    "trace": lambda: vs.trace(HOT.field, POINTS, POINTS, NONE),
    "trace, of lists": lambda: vs.trace(HOT.field, [], [], 3.0),
    "triangulate": lambda: vs.triangulate(HOT.sensor, PIXELS),
    "triangulate, of a list": lambda: vs.triangulate(HOT.sensor, []),
    "triangulate, bent": lambda: vs.triangulate(HOT, PIXELS, medium=HOT.medium),
    "triangulate, bent, of a list": lambda: vs.triangulate(HOT, [], medium=HOT.medium),
    "IndexField.refractivity": lambda: HOT.field.refractivity(POINTS),
    "IndexField.gradient": lambda: HOT.field.gradient([]),
    "line_sensitivity": lambda: line_sensitivity(HOT, NONE),
    "bent_points": lambda: vs.bent_points(HOT, NONE),
    "laser_y_at": lambda: laser_y_at(HOT, NONE),
    "incidence_points": lambda: incidence_points(HOT, NONE),
    "seen_points": lambda: seen_points(HOT, PIXELS),
    "misses": lambda: misses(HOT, POINTS, PIXELS),
    "newton_along_line": lambda: newton_along_line(HOT, NONE),
    "inside_part": lambda: inside_part(HOT, POINTS),
    "Pinhole.project": lambda: HOT.sensor.camera.project(POINTS),
    "Pinhole.lines_of_sight": lambda: HOT.sensor.camera.lines_of_sight(PIXELS),
}
# What takes a name, a scene, an image or its line: an image has pixels.
OTHERS = {
    "pattern_of",
    "calibrate_fringes",
    "find_marks",
    "projector_marks",
    "codec_of",
    "record",
    "difference",
    "dot_centres",
    "fit_cylinder",
    "fit_shape",
    "gaussian_blur",
    "read_calibration",
    "read_image",
    "diffraction_blur",
    "speckled",
    "save_png",
    "save_tiff",
    "compare_line",
    "reconstruct",
    "load_scene",
    "new_scene",
    "survey",
    "render",
    "render_exposure",
    "render_frame",
    "render_sequence",
    "grey_values",
    "image_sensor",
    "image_sensors",
    "line_centres",
    "lines_by_source",
    "estimate_air",
    "fringe_observation",
    "identifiability",
    "error_budget",
    "known_air_budget",
}


def lengths(result):
    """Lengths of all arrays in a result."""
    if is_dataclass(result):
        return {n for f in fields(result) for n in lengths(getattr(result, f.name))}
    if isinstance(result, dict):
        return {n for value in result.values() for n in lengths(value)}
    return {len(result)}


def test_nothing_given_gives_nothing():
    """Rationale: a line of which nothing was found is no error, whatever is asked of it."""
    for name in EMPTY:
        assert lengths(EMPTY[name]()) == {0}, name


def test_every_public_function_is_asked_for_nothing():
    """Rationale: a function that is new must answer to nothing too."""
    functions = {name for name in vs.__all__ if inspect.isfunction(getattr(vs, name))}
    assert functions - OTHERS == functions & EMPTY.keys()


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_rows_come_back_as_they_went(count):
    """Rationale: the rows that Dr.Jit is given beside those of the caller are nobody's."""
    points = np.random.default_rng(1).random((count, 3))

    def through(points, numbers):
        assert len(points) == len(numbers) == max(count, 2)
        assert np.all(np.abs(points) > 0.0)  # a direction of length 0 is none
        return {"points": to_numpy(to_vectors(points)), "both": (to_scalars(numbers).numpy(), "")}

    result = by_rows(through, points, points[:, 1])
    np.testing.assert_array_equal(result["points"], points)
    np.testing.assert_array_equal(result["both"][0], points[:, 1])


def test_a_constant_component_is_that_of_every_row():
    """Rationale: in a field that does not vary along x, the gradient's x is a number to Dr.Jit."""
    vectors = mi.Array3f64(0.0, mi.Float64([1.0, 2.0, 3.0]), 0.5)
    expected = [[0.0, 1.0, 0.5], [0.0, 2.0, 0.5], [0.0, 3.0, 0.5]]
    np.testing.assert_array_equal(to_numpy(vectors), expected)


@pytest.mark.parametrize("brought", [to_vectors, to_scalars])
def test_an_empty_array_does_not_reach_drjit(brought):
    """Rationale: a ray query of none ends the process, with everything that is not saved."""
    with pytest.raises(ValueError, match="no empty array"):
        brought(POINTS)


@pytest.mark.parametrize("kind", [mi.Float, mi.Float64, mi.UInt32])
def test_numbers_are_drjits_own(kind):
    """Rationale: NumPy's memory may change, or go, while a kernel is still to read it."""
    numbers = np.arange(12, dtype=np.int64).reshape(3, 4)
    own = in_own_memory(numbers.T, kind)
    expected = numbers.T.ravel().tolist()
    numbers[:] = -1
    assert dr.width(own) == 12
    assert own.numpy().tolist() == expected


AT_THE_END_OF_A_PAGE = """
import ctypes, mmap, numpy as np
from virtual_sensor.arrays import in_own_memory, to_numpy, to_vectors
from virtual_sensor.engine import mi

empty, array, kept = np.empty, np.array, []

def guarded(values):
    memory = mmap.mmap(-1, (-(-values.nbytes // mmap.PAGESIZE) + 1) * mmap.PAGESIZE)
    kept.append(memory)
    last = len(memory) - mmap.PAGESIZE
    first = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    assert ctypes.CDLL(None).mprotect(ctypes.c_void_p(first + last), mmap.PAGESIZE, 0) == 0
    placed = np.frombuffer(memory, values.dtype, values.size, last - values.nbytes)
    placed = placed.reshape(values.shape)
    placed[...] = values
    return placed

np.empty = lambda *given, **also: guarded(empty(*given, **also))
np.array = lambda *given, **also: guarded(array(*given, **also))
for count in (2, 13, 4097):
    numbers = np.arange(float(count))
    assert (in_own_memory(numbers, mi.Float64).numpy() == numbers).all()
    points = np.ones((count, 3))
    assert (to_numpy(to_vectors(points)) == points).all()
"""


def test_no_kernel_reads_beyond_memory_that_is_ours():
    """Rationale: whole packets are read, past an array's end; where a page ends there: signal 11.

    NumPy's arrays are put before a page that must not be read, in a process of their own.
    """
    ended = subprocess.run([sys.executable, "-c", AT_THE_END_OF_A_PAGE], capture_output=True)
    assert ended.returncode == 0, ended.stderr.decode()
