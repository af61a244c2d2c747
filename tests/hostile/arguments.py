"""Calls of the package's functions with numbers and arrays that nobody should give.

Numbers are NaN, infinite, huge, tiny, negative, zero; arrays are empty, of other shapes and
types, masked. What a type checker refuses (a text for a number) is not among them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from hostile.cases import Case, Result
from hostile.image_files import pictures
from hostile.images import NEAR_PX, OK
from hypothesis import strategies as st

NUMBERS = (
    float("nan"), float("inf"), float("-inf"), 0.0, -0.0, -1.0, 1e-320, 1e-30, 1e30, 1e300, -1e300,
    0.5, 1.0, 2.0, 15.0, 255.0, 1e4, np.float32(1e-3), np.int8(-1),
)  # fmt: skip
WHOLE = (0, -1, 1, 2, 3, 7, 15, 100, 2**31 - 1, 2**31, 2**63, 2**70, -(2**70), 10**9, True)
TYPES = ("f8", "f4", "u1", "u2", "i2", "i4", "u4", "f2", "?", "c8", "O", ">f4", ">u2", "U4")
METHODS = (
    "gaussian", "weighted_gaussian", "max_likelihood", "log_parabola", "parabola", "steger",
    "linear_interpolation", "centre_of_gravity", "fir4", "fir8", "", "nosuch", "a.b:c", "os:getcwd",
)  # fmt: skip


def _chosen(*sensible: Any):
    return st.sampled_from((*sensible, *NUMBERS))


@st.composite
def arrays(draw, *shapes: tuple[int, ...]):
    """Small arrays of these shapes or others, with any numbers."""
    others = ((), (0,), (0, 3), (3, 0), (1,), (2, 2), (2, 3, 4), (5, 2), (3,), (1, 1, 1, 1))
    shape = draw(
        st.sampled_from((*shapes, *others))
        if draw(st.integers(0, 4)) == 0
        else st.sampled_from(shapes)
    )
    made = np.array(np.linspace(0.5, 9.5, int(np.prod(shape))).reshape(shape))
    if made.size and draw(st.integers(0, 3)) == 0:
        made.flat[draw(st.integers(0, made.size - 1))] = draw(st.sampled_from(NUMBERS))
    kind = draw(st.sampled_from(("f8", "f8", "f8", "f4", "i4", "?")))
    with np.errstate(all="ignore"):
        return made.astype(kind)


@st.composite
def images(draw):
    """An image of a known line, or something that is none, and the line's row."""
    picture = draw(pictures())
    grey = picture.grey(np.float64, draw(st.sampled_from((1.0, 200.0, 4000.0, 1e-30, 1e30, 1e300))))
    how = draw(st.sampled_from(("line", "line", "typed", "holes", "masked", "shape", "flat")))
    truth: Any = picture
    if how == "typed":
        with np.errstate(all="ignore"):
            grey, truth = grey.astype(draw(st.sampled_from(TYPES))), None
    elif how == "holes":
        rng = np.random.default_rng(draw(st.integers(0, 99)))
        bad = draw(st.sampled_from((np.nan, np.inf, -np.inf, 1e300)))
        grey[rng.random(grey.shape) < draw(st.sampled_from((0.01, 0.5, 1.0)))] = bad
        truth = None
    elif how == "masked":
        rows, columns = np.indices(grey.shape)
        mask = np.abs(rows - picture.row(columns)) < 8.0
        grey, truth = np.ma.masked_array(grey, mask), "masked"
    elif how == "shape":
        shape = draw(
            st.sampled_from(((0, 5), (5, 0), (1, 1), (1, 9), (9, 1), (2, 3), (4, 4, 3), ()))
        )
        grey, truth = np.ones(shape), None
    elif how == "flat":
        grey = np.full_like(grey, draw(st.sampled_from(NUMBERS)))
        truth = "masked"
    return grey, truth


@st.composite
def line_calls(draw):
    """`line_centres`."""
    image, truth = draw(images())
    options: dict[str, Any] = {"image": image, "method": draw(st.sampled_from(METHODS))}
    more = {
        "along": st.sampled_from(("columns", "rows", "", "x")),
        "peaks": st.sampled_from(WHOLE),
        "min_amplitude": _chosen(0.01, 0.1),
        "saturation": _chosen(None, 100.0),
        "max_sigma": _chosen(3.0, 8.0, 32.0),
        "noise": _chosen(None, 1.0),
        "gain": _chosen(0.0, 0.4),
    }
    names = draw(st.lists(st.sampled_from(list(more)), max_size=3, unique=True))
    options |= {name: draw(more[name]) for name in names}
    sensible = not {"along", "peaks", "saturation", "noise", "gain"} & set(names)

    def judge(result: Result) -> str:
        good = result["status"] == OK
        row, column = result["row"][good], result["column"][good]
        if not (np.isfinite(row).all() and np.isfinite(column).all()):
            return "a centre is ok, and nowhere"
        if truth == "masked" and good.any():
            return f"{good.sum()} ok centres where nothing is to be seen"
        if truth is not None and truth != "masked" and sensible:
            away = np.abs(row - truth.row(column))
            if away.max(initial=0.0) > NEAR_PX:
                return f"a centre is {away.max():.3g} px off, and ok"
        return ""

    return "line_centres", options, judge


@st.composite
def air_calls(draw):
    """`air_refractivity`: refused, or the refractivity of a gas."""
    names = ("wavelength_nm", "temperature_c", "pressure_pa", "relative_humidity", "co2_ppm")
    chosen = draw(st.lists(st.sampled_from(names), min_size=1, max_size=3, unique=True))
    sensible = (532.0, 1200.0, 1e5, 0.5, 400.0, np.array([]), np.array([[500.0, np.nan]]))
    options = {name: draw(_chosen(*sensible)) for name in chosen}

    def judge(result: Result) -> str:
        values = np.asarray(result["value"])
        if not ((values > 0.0) & (values < 1e-3)).all():
            return f"air of n - 1 = {values}"
        return ""

    return "air_refractivity", options, judge


@st.composite
def field_calls(draw):
    """`IndexField.from_arrays`, and what it says of points."""
    with np.errstate(all="ignore"):
        nodes = draw(arrays((4, 4, 4), (5, 4, 6))).astype(float)
        nodes *= draw(st.sampled_from((1e-5, 1e-5, 1.0, 1e300)))
    options: dict[str, Any] = {"refractivity": nodes}
    options["origin_mm"] = draw(arrays((3,)))
    spacing = st.sampled_from((np.full(3, 2.0), np.full(3, 1e-200), np.full(3, 1e200)))
    options["spacing_mm"] = draw(spacing | arrays((3,)))
    options["ambient"] = draw(_chosen(2.7e-4, 2.7e-4, 2.7e-4))
    if draw(st.booleans()):
        options["mirror"] = draw(st.sampled_from(((), (True,) * 4, (True, False, False))))
    if draw(st.booleans()):
        options["solid"] = draw(st.sampled_from((np.ones((4, 4, 4), bool), np.zeros((4, 4, 4)))))
    options["points_mm"] = draw(arrays((5, 3)))

    def judge(result: Result) -> str:
        values, points = result["value"], np.asarray(options["points_mm"], float).reshape(-1, 3)
        known = np.isfinite(points).all(axis=1)
        around = float(options["ambient"])
        low, high = min(nodes.min(), around), max(nodes.max(), around)
        room = 0.5 * (high - low) + 1e-12
        if not ((values[known] > low - room) & (values[known] < high + room)).all():
            return f"n - 1 of {values} between nodes of {low:g} to {high:g}"
        return ""

    return "from_arrays", options, judge


@st.composite
def ray_calls(draw):
    """`ray_search` and `trace`."""
    if draw(st.booleans()):
        options: dict[str, Any] = {"laser_y_mm": draw(arrays((5,), (9,)))}
        more = {
            "method": st.sampled_from(("paper", "newton", "", "x")),
            "k_stop": st.sampled_from((0, -3, 1, 15)),
            "r_max_um": _chosen(1.0),
            "z_max_mm": _chosen(0.1),
            "grid_px": st.sampled_from(((32.0, 32.0), (0.0, 0.0), (np.nan, 1.0), (-1.0, 1.0))),
        }
        function = "ray_search"
    else:
        options = {"origins_mm": draw(arrays((2, 3))), "directions": draw(arrays((2, 3)))}
        options["length_mm"] = draw(arrays((2,)) | _chosen(10.0))
        more = {
            "step_mm": _chosen(1.0, 0.5),
            "method": st.sampled_from(("rk4", "leapfrog", "", "x")),
            "precision": st.sampled_from(("double", "single", "", "x")),
            "tolerance_mm": _chosen(1e-6),
        }
        function = "trace"
    names = draw(st.lists(st.sampled_from(list(more)), max_size=2, unique=True))
    options |= {name: draw(more[name]) for name in names}

    def judge(result: Result) -> str:
        good = result["status"] == OK
        return "" if np.isfinite(result["value"][good]).all() else "found, and nowhere"

    return function, options, judge


@st.composite
def frame_calls(draw):
    """`render`, `triangulate` and `grey_values`."""
    function = draw(st.sampled_from(("render", "triangulate", "grey_values", "grey_values")))
    if function == "render":
        spp = st.sampled_from((None, 0, -1, 1, 4, 7, 2**31, 2**33, 2**63, 2**70, True))
        options: dict[str, Any] = {"spp": draw(spp)}
        options["seed"] = draw(st.sampled_from((0, 1, -1, 2**31, 2**32, 2**70)))
    elif function == "triangulate":
        options = {"pixel": draw(arrays((5, 2), (1, 2), (4, 5, 2)))}
    else:
        options = {"irradiance": draw(arrays((4, 5), (1, 1)))}
        names = ("quantum_efficiency", "gain", "dark_noise_e", "full_well_e", "black_level", "prnu")
        chosen = draw(st.lists(st.sampled_from(names), max_size=2, unique=True))
        options["camera"] = {name: draw(_chosen()) for name in chosen}

    def judge(result: Result) -> str:
        values = np.asarray(result["value"])
        return "" if not np.isinf(values).any() else "infinite"

    return function, options, judge


@st.composite
def cases(draw):
    """A call."""
    makers = (line_calls, line_calls, line_calls, air_calls, field_calls, ray_calls, frame_calls)
    function, options, judge = draw(draw(st.sampled_from(makers))())
    return Case("call", f"call/{function}", {}, "", judge, {"function": function, **options})
