"""Whatever a camera may give: a status for each centre, or an error that says what to do."""

import numpy as np
import pytest

from virtual_sensor.errors import InputError
from virtual_sensor.metrology.detectors import NAMES
from virtual_sensor.metrology.line_peaks import line_centres

DTYPES = (
    np.uint8, np.uint16, np.float32, np.float64, np.int16, np.int32, np.uint32, np.float16, bool,
    complex, object, ">f4", ">u2",
)  # fmt: skip


def line(rng, shape):
    """A line that wanders through the image, of any width and height, on any level."""
    height, width = shape
    row = rng.uniform(-3, height + 3) + rng.uniform(-1, 1) * np.arange(width)
    away = np.arange(height)[:, None] - row
    return rng.uniform(-5, 5) + np.exp(-((away / rng.choice([0.2, 1.0, 3.0, 40.0])) ** 2) / 2.0)


def image(rng):
    """An image that no detector was made for."""
    shape = tuple(
        rng.choice([0, 1, 2, 3, 5, 17, 40], 2, p=[0.02, 0.05, 0.05, 0.05, 0.13, 0.3, 0.4])
    )
    kinds = {
        "constant": lambda: np.full(shape, rng.choice([0.0, 1.0, -1.0, 255.0, 1e300, -1e300])),
        "noise": lambda: rng.normal(0.0, 1.0, shape),
        "spikes": lambda: (rng.random(shape) > 0.95) * 10.0 ** rng.integers(-30, 30),
        "line": lambda: line(rng, shape) * 10.0 ** rng.integers(-30, 30),
        "ramp": lambda: np.add.outer(np.arange(shape[0]), rng.normal() * np.arange(shape[1])),
        "walk": lambda: np.cumsum(rng.normal(0.0, 1.0, shape), axis=0),
        "checks": lambda: np.indices(shape).sum(axis=0) % 2 * 200.0,
        "colour": lambda: np.repeat(line(rng, shape)[:, :, None], 3, axis=2),
        "flat list": lambda: line(rng, shape).ravel(),
        "stack": lambda: line(rng, shape)[None, None],
        "text": lambda: np.full(shape, "line"),
        "huge": lambda: line(rng, shape) * 1e307,
        "tiny": lambda: line(rng, shape) * 5e-324,
    }
    made = kinds["line" if rng.random() < 0.3 else rng.choice(list(kinds))]()
    if made.dtype.kind == "f":
        for bad in (np.nan, np.inf, -np.inf):
            if rng.random() < 0.15:
                made = np.where(rng.random(made.shape) < rng.choice([0.01, 0.5, 1.0]), bad, made)
        with np.errstate(all="ignore"):
            if rng.random() < 0.3:
                made = (made * rng.choice([1.0, 200.0])).astype(DTYPES[rng.integers(len(DTYPES))])
    if rng.random() < 0.1 and made.ndim == 2:
        made = made[:, ::-1].T  # not contiguous
    made.flags.writeable = False
    return made


def check(number):
    """One image, one detector, any options: centres in the image, or InputError."""
    rng = np.random.default_rng(number)
    picture, method = image(rng), NAMES[number % len(NAMES)]
    options = {
        "along": str(rng.choice(["columns", "rows"])),
        "peaks": int(rng.integers(1, 4)),
        "saturation": rng.choice([None, 0.5, 200.0]),
        "noise": rng.choice([None, 0.0, 1.0]),
        "gain": float(rng.choice([0.0, 1.0])),
        "max_sigma": float(rng.choice([0.51, 3.0, 32.0, 1e4])),
        "min_amplitude": float(rng.choice([0.0, 0.01, 0.999])),
    }
    try:
        found = line_centres(picture, method, **options)
    except InputError:
        assert picture.ndim != 2 or 0 in picture.shape or picture.dtype not in DTYPES[:4]
        return "refused"
    height, width = picture.shape
    good = found.found
    for place, size in ((found.row, height), (found.column, width)):
        assert np.all((place[good] >= -0.5) & (place[good] <= size - 0.5))
    assert not np.any(np.isfinite(found.pixel[~good]))
    assert np.all(np.isfinite(found.pixel[good]))
    assert np.all((found.sigma[good] >= 0.0) | np.isnan(found.sigma[good]))
    return "found" if good.any() else "none"


def test_a_thousand_hostile_images_do_no_harm():
    """No crash, no centre off the image, and (pytest makes them errors) no warning."""
    outcome = [check(number) for number in range(1000)]
    assert {"refused", "found", "none"} == set(outcome)


@pytest.mark.slow
def test_ten_thousand_hostile_images_do_no_harm():
    """The rest of them: other seeds for every detector."""
    for number in range(1000, 10_000):
        check(number)
