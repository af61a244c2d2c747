"""Every option of detectors, cameras, lenses and speckle is within its bounds, or refused."""

import numpy as np
import pytest
from artificial import dot_image, line_image

from virtual_sensor.devices.image_sensor import ImageSensor
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.grey_values import exposed, grey_values
from virtual_sensor.imaging.image_blur import defocus_blur, gaussian_blur
from virtual_sensor.imaging.speckle import Aperture, speckled
from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.detectors import NAMES
from virtual_sensor.metrology.deviation import round_pixel
from virtual_sensor.metrology.dot_peaks import DotStatus, dot_centres
from virtual_sensor.metrology.line_peaks import line_centres

NAN, INF = float("nan"), float("inf")
NO_NUMBER = (NAN, -INF, "3", [1, 2], np.array([1.0]), 1 + 2j, {}, b"1", 10**400)
NOT_POSITIVE = (*NO_NUMBER, None, INF, -1.0, 0.0)
NEGATIVE = (*NO_NUMBER, INF, -1.0)
LINE = line_image(np.full(30, 20.3), 2.0, 100.0, height=40)
DOTS = dot_image([[20.0, 20.0]], 2.0, shape=(40, 40))

REFUSED = {
    "peaks": (line_centres, LINE, (*NO_NUMBER, None, 0, -1, 1.0, 101, 10**9, 1e9)),
    "min_amplitude": (line_centres, LINE, (*NEGATIVE, None, 1.0)),
    "saturation": (line_centres, LINE, NO_NUMBER),
    "max_sigma": (line_centres, LINE, (*NOT_POSITIVE, 0.5, 1e9)),
    "noise": (line_centres, LINE, NEGATIVE),
    "gain": (line_centres, LINE, (*NEGATIVE, None)),
    "along": (line_centres, LINE, (*NO_NUMBER, None, "diagonal")),
    "method": (line_centres, LINE, (NAN, [1, 2], None, {}, 3, "no such")),
    "threshold": (dot_centres, DOTS, (*NOT_POSITIVE, 1.0)),
    "min_area": (dot_centres, DOTS, (*NOT_POSITIVE, 2.5)),
    "sigma_px": (gaussian_blur, LINE, (*NEGATIVE, None, 1e9)),
    "radius_px": (defocus_blur, LINE, (*NEGATIVE, None, 1e9)),
    "step": (round_pixel, np.zeros((3, 2)), (*NOT_POSITIVE,)),
}


@pytest.mark.parametrize("option", REFUSED)
def test_an_option_out_of_its_bounds_is_refused_by_its_name(option):
    """Whatever type it is of, for every detector."""
    function, image, values = REFUSED[option]
    for value in values:
        for method in NAMES if function is line_centres and option != "method" else [None]:
            given = {option: value} | ({"method": method} if method else {})
            with pytest.raises(InputError, match=f"{option}|method|detector"):
                function(image, **given)


def test_a_camera_is_of_positive_finite_numbers():
    """EMVA 1288's parameters: a camera that can't be is refused when it is made."""
    for name in ("quantum_efficiency", "gain", "full_well_e", "bit_depth"):
        for value in NOT_POSITIVE:
            with pytest.raises(InputError, match=name):
                ImageSensor(**{name: value})


def test_a_cameras_noise_is_not_negative():
    """Nil is allowed."""
    for name in ("dark_noise_e", "black_level", "dsnu_e", "prnu", "pattern_seed"):
        for value in (*NEGATIVE, None):
            with pytest.raises(InputError, match=name):
                ImageSensor(**{name: value})
        ImageSensor(**{name: 0})


def test_an_aperture_is_of_positive_finite_numbers():
    """Or it is refused when it is made."""
    for name in ("f_number", "wavelength_nm", "pixel_um", "polarisations"):
        for value in NOT_POSITIVE:
            with pytest.raises(InputError, match=name):
                Aperture(**({"f_number": 5.6} | {name: value}))


def test_what_is_no_image_of_light_is_refused():
    """Text, objects, complex numbers and empty images, by every step that makes images worse."""
    camera = ImageSensor()
    steps = (
        lambda image: grey_values(image, camera),
        lambda image: exposed(image, 100.0, camera),
        lambda image: gaussian_blur(image, 1.0),
        lambda image: defocus_blur(image, 1.0),
        lambda image: speckled(image, Aperture(5.6)),
    )
    for image in ([["a"]], [[None]], [[1j]], np.full((4, 4), object()), np.full((4, 4), NAN)):
        for number, step in enumerate(steps):
            with pytest.raises(InputError):
                print(number, step(image))
    for peak in NOT_POSITIVE:
        with pytest.raises(InputError, match="peak_e"):
            exposed(LINE, peak, camera)


def test_memory_order_and_write_protection_do_not_matter():
    """Fortran's order, a read-only and a reversed view give the same bits, and stay as they are."""
    for method in NAMES:
        image = line_image(20.0 + 0.1 * np.arange(60), 2.0, 100.0, height=50)
        expected = line_centres(image, method)
        locked = image.copy()
        locked.flags.writeable = False
        backwards = image[::-1, ::-1].copy()[::-1, ::-1]
        for same in (np.asfortranarray(image), locked, backwards, image.astype(">f8")):
            found = line_centres(same, method)
            np.testing.assert_array_equal(found.row, expected.row, err_msg=f"{method=}")
            np.testing.assert_array_equal(same, image, err_msg=f"{method=}")
        assert np.any(expected.status == Status.OK), method


def test_where_there_is_nothing_no_status_is_ok():
    """One row, one column, no number at all: NaN, and why."""
    for method in NAMES:
        for image in (
            np.ones((1, 9)),
            np.ones((9, 1)),
            np.full((9, 9), NAN),
            np.full((9, 9), INF),
            np.full((9, 9), -INF),
            np.where(np.arange(9) < 4, NAN, np.ones((9, 9))),
        ):
            for along in ("columns", "rows"):
                line = line_centres(image, method, along=along)
                assert not np.any(line.status == Status.OK), method
                assert np.all(np.isnan(line.pixel)), method
        for shape in ((0, 5), (5, 0), (0, 0), (5,), (5, 5, 3), ()):
            with pytest.raises(InputError, match="shape"):
                line_centres(np.zeros(shape), method)


def test_a_dot_without_light_has_no_centre():
    """A hollow ring of light: its rim is as bright as what it holds."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        image = rng.choice([0.0, 1.0, -1.0, 50.0], (12, 12), p=[0.5, 0.3, 0.1, 0.1])
        dots = dot_centres(image, min_area=1)
        good = dots.status == DotStatus.OK
        assert np.all(np.isfinite(dots.pixel[good]))
        assert np.all(dots.flux[good] > 0.0)
        assert np.all((dots.pixel[good] >= 0.0) & (dots.pixel[good] <= 11.0))
        assert np.all(np.isnan(dots.flux[~good]))
