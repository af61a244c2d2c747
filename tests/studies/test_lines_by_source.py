"""Two lasers in one scene: each line is found as in the frame with that laser alone."""

import re

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt
from several import text_of

import virtual_sensor as vs
from virtual_sensor.devices.image_sensor import ImageSensor
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.grey_values import exposed, grey_values
from virtual_sensor.imaging.image_blur import gaussian_blur
from virtual_sensor.metrology.centres import Status
from virtual_sensor.studies.lines_by_source import expected_light

FILM = {"width": 1024, "height": 1024, "line_radius": 0.15}


def crossing(folder, name, roll_deg, power):
    """Two lasers whose lines cross on the part: the second's sheet is rolled, and as bright."""
    text = text_of(name, [("eye", 0, 1)], [("red", 0, 0), ("blue", 0, 0)])
    head, emitter, rest = re.split(r'(<emitter type="laser_line" id="blue">)', text)
    rest = rest.replace("<lookat", f'<rotate z="1" angle="{roll_deg}"/><lookat', 1)
    rest = re.sub(r'(name="power" value=)"[^"]*"', rf'\1"{power}"', rest, count=1)
    path = folder / f"crossing_{name}.xml"
    path.write_text(head + emitter + rest, encoding="utf-8")
    return vs.load_scene(path, **FILM)


@pytest.fixture(scope="module", params=["hot_cylinder", "stepped_shaft"])
def scene(request, tmp_path_factory):
    return crossing(tmp_path_factory.mktemp("crossing"), request.param, 25, 0.3)


@pytest.fixture(scope="module")
def image(scene):
    return vs.render(scene)


@pytest.fixture(scope="module")
def alone(scene):
    """The images of each laser by itself."""
    return {name: vs.render(scene.only(source=name)) for name in scene.sources}


def test_each_line_is_that_of_its_laser_alone(scene, image, alone):
    """Rationale: to 0.002 px where they don't overlap, with the same status in every column."""
    found = vs.lines_by_source(scene, image)
    assert list(found) == ["red", "blue"]
    for name, line in found.items():
        known = vs.line_centres(alone[name], choose="highest")
        free = line.status != Status.OVERLAPPING
        both = (line.status == Status.OK) & (known.status == Status.OK)
        assert both.sum() > 150
        assert np.sum(free & (known.status == Status.OK) & ~both) <= 4  # beside the overlap
        np.testing.assert_allclose(line.row[both], known.row[both], atol=0.002)
        assert 5 < np.sum(~free) < 0.5 * both.sum()
        assert np.isnan(line.row[~free]).all()


def test_no_centre_is_of_both_lasers_light(scene, image, alone):
    """Rationale: by the frames of each alone: where both shine near a centre it must not be OK."""
    for name, line in vs.lines_by_source(scene, image).items():
        (other,) = (light for each, light in alone.items() if each != name)
        column = np.flatnonzero(line.status == Status.OK)
        rows = np.rint(line.row[column]).astype(int) + np.arange(-4, 5)[:, None]
        assert np.all(other[rows, column] == 0.0)


def test_a_recorded_image_is_told_apart_too(scene, image, alone):
    """Rationale: blur and noise: errors are those of the one line recorded alone."""
    camera = ImageSensor(gain=0.37, bit_depth=12)
    options = {"noise": camera.grey_noise, "gain": camera.gain, "saturation": camera.saturation}

    def recorded(radiance, seed):
        return grey_values(exposed(gaussian_blur(radiance, 0.5), 4000.0, camera), camera, seed=seed)

    found = vs.lines_by_source(scene, recorded(image, 1), margin_px=3.0, **options)
    for name, line in found.items():
        exact = vs.line_centres(gaussian_blur(alone[name], 0.5), choose="highest")
        both = (line.status == Status.OK) & (exact.status == Status.OK)
        assert both.sum() > 150
        error = (line.row - exact.row)[both] / line.sigma[both]
        assert np.sqrt(np.mean(error**2)) < 1.5


def test_a_scene_with_one_source_has_one_line(scene, alone):
    """Rationale: of one source nothing overlaps, and nothing is to be taken out."""
    (line,) = vs.lines_by_source(scene.only(source="red"), alone["red"]).values()
    highest = vs.line_centres(alone["red"], choose="highest")
    np.testing.assert_array_equal(line.row, highest.row)


def test_an_image_of_another_size_is_refused(scene):
    """Rationale: of two cameras' images the wrong one may be given."""
    with pytest.raises(InputError, match=r"image is of shape \(10, 10\), .* \(1024, 1024\)"):
        vs.lines_by_source(scene, np.zeros((10, 10), np.float32))
    with pytest.raises(InputError, match="no camera 'ear'"):
        vs.lines_by_source(scene, np.zeros((10, 10), np.float32), camera="ear")


def test_more_margin_is_more_pixels(scene):
    """Rationale: each pixel that is lit, and those within the margin of one."""
    lit, near = expected_light(scene, 0.0), expected_light(scene, 2.0)
    for name in scene.sources:
        distance = distance_transform_edt(~lit[name])
        assert near[name][distance <= 2.0].all()
        assert not near[name][distance > np.hypot(2.0, 1.0)].any()
