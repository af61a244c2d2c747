"""Air with free parameters: transforms of fields, and their derivatives."""

import pickle

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.medium.broadening import blurred, widened
from virtual_sensor.medium.leaning import leaned
from virtual_sensor.poses import Pose

AMBIENT = 2.7e-4
SIZE = np.array([9.0, 4.0, 6.0])  # standard deviations of the plume, mm
HOTTEST_MM = 5.0
TURNED = Pose.turn(40.0, (1.0, 2.0, -1.0), (3.0, 0.0, 7.0))
VALUES = {
    "scale": 1.1,
    "lean": -4.0,
    "width": 1.3,
    "offset": 1.7,
    "height": -2.3,
    "blur": 1.9,
    "pressure": 93e3,
    "temperature": 1010.0,
}


def contrast(temperature):
    """What the hottest air lacks of the surrounding n - 1."""
    return 1e-4 * (1.0 + (temperature - 900.0) / 500.0 - ((temperature - 900.0) / 900.0) ** 2)


def plume(temperature=900.0):
    """A Gaussian plume, of which a quarter is held."""
    axes = np.meshgrid(np.arange(21), np.arange(41), np.arange(81), indexing="ij")
    spacing, origin = np.array([2.0, 0.75, 0.75]), np.array([0.0, 0.0, HOTTEST_MM - 30.0])
    places = origin + spacing * np.stack(axes, axis=-1) - [0.0, 0.0, HOTTEST_MM]
    hot = np.exp(-0.5 * np.sum((places / SIZE) ** 2, axis=-1))
    return vs.IndexField.from_arrays(
        AMBIENT - contrast(temperature) * hot,
        origin,
        spacing,
        ambient=AMBIENT,
        mirror=(True, True, False),
    )


@pytest.fixture(scope="module")
def model():
    return vs.AirModel.of({t: plume(t) for t in (900.0, 1000.0, 1250.0)})


@pytest.fixture(scope="module")
def points():
    """Also beyond y = 0, and none at the border, where the field jumps in and out."""
    return np.random.default_rng(3).uniform([-15, -10, -8], [15, 10, 20], (500, 3))


def expected(points, scale, lean, width, offset, height, blur, pressure, temperature):
    """Refractivity by convolved Gaussians: across, in y and z, of a covariance each."""
    shear = np.array([[width, width * np.tan(np.radians(lean))], [0.0, 1.0]])
    before = shear @ np.diag(SIZE[1:] ** 2) @ shear.T
    after = before + blur**2 * np.eye(2)
    across = points[:, 1:] - shear @ [0.0, HOTTEST_MM] - [offset, height]
    distance = np.einsum("ni,ij,nj->n", across, np.linalg.inv(after), across)
    hot = np.exp(-0.5 * ((points[:, 0] / SIZE[0]) ** 2 + distance))
    hot *= np.sqrt(np.linalg.det(before) / np.linalg.det(after))
    return pressure / 101325.0 * (AMBIENT - scale * contrast(temperature) * hot)


def test_the_transforms_make_the_plume_that_a_formula_gives(model, points):
    """Rationale: order and sense of all, of a field whose convolution is known."""
    for values in (VALUES, VALUES | {"blur": 0.0}):  # that takes the spline of the fields given
        found = model.at(**values)
        atol = 5e-5 * contrast(1000.0)  # of splines between nodes, two where it leans
        n = expected(points, **values)
        np.testing.assert_allclose(found.refractivity(points), n, rtol=0, atol=atol)
        again = found.with_nodes(found.nodes)  # another spline, through the same nodes
        np.testing.assert_allclose(again.refractivity(points), n, rtol=0, atol=atol)
        assert found.pressure_pa == 93e3
        assert found.ambient == pytest.approx(AMBIENT * 93e3 / 101325.0, rel=1e-12)


@pytest.mark.slow
def test_every_derivative_is_that_of_a_difference(model, points):
    """Of n - 1 and of its gradient, within 1e-5 of the largest; of one moved and turned too."""
    steps = {"temperature": 1.0, "pressure": 100.0, "width": 1e-4, "scale": 1e-3}
    turned = vs.AirModel.of({t: each.moved(TURNED) for t, each in model.fields.fields.items()})
    for each, places in ((model, points), (turned, TURNED.to_world(points))):
        found = each.derivatives(VALUES, **VALUES)
        assert list(found) == list(VALUES)
        for name, by in found.items():
            e = steps.get(name, 1e-3)
            plus, minus = (each.at(**{**VALUES, name: VALUES[name] + s * e}) for s in (1, -1))
            for what in ("refractivity", "gradient"):
                high, low, here = (getattr(air, what)(places) for air in (plus, minus, by))
                difference = (high - low) / (2.0 * e)
                atol = 1e-5 * abs(difference).max()
                np.testing.assert_allclose(here, difference, rtol=0, atol=atol, err_msg=name)
                assert atol > 0.0
            assert by.pose == plus.pose or name in ("offset", "height")


def test_at_its_defaults_it_is_the_field_itself(model):
    one = plume()
    assert vs.AirModel.of(one).at() is one
    assert vs.AirModel.of(one).at(**vs.AirModel.of(one).defaults) is one
    assert model.defaults["temperature"] == 1075.0
    assert model.at(temperature=1000.0) is model.fields.fields[1000.0]
    assert vs.AirModel.of(model.fields, temperature_c=900.0).at() is model.fields.fields[900.0]


def test_air_leans_about_the_top_line_whatever_its_mirror_planes():
    """The same air held as a whole, and moved and turned, leans in the same way."""
    quarter = plume()
    y = quarter.spacing[1] * np.arange(-40, 41)
    nodes = np.concatenate([quarter.nodes[:, :0:-1], quarter.nodes], axis=1)
    whole = quarter.from_arrays(
        nodes,
        [0.0, y[0], quarter.origin[2]],
        quarter.spacing,
        ambient=AMBIENT,
        mirror=(True, False, False),
    )
    places = np.random.default_rng(2).uniform(-10, 15, (50, 3))
    n = leaned(quarter, 6.0).refractivity(places)
    np.testing.assert_allclose(leaned(whole, 6.0).refractivity(places), n, rtol=0, atol=1e-12)
    turned = leaned(quarter.moved(TURNED), 6.0)
    np.testing.assert_allclose(turned.refractivity(TURNED.to_world(places)), n, rtol=0, atol=1e-12)
    model = vs.AirModel.of(quarter)
    by = model.derivatives(["lean"])["lean"].refractivity(places)  # of upright air
    change = [model.at(lean=angle).refractivity(places) for angle in (1e-3, -1e-3)]
    np.testing.assert_allclose(by, (change[0] - change[1]) / 2e-3, atol=1e-5 * abs(by).max())
    at_top = places * [1.0, 1.0, 0.0]
    upright = quarter.refractivity(at_top)
    error = leaned(quarter, 6.0).refractivity(at_top) - upright
    assert abs(error).max() < 3e-5 * contrast(900.0)


def test_it_widens_and_blurs_as_a_scene_does():
    """`-D widen=1.4 -D blur=2`: but for the tail that is cut off four sigmas out."""
    one = plume()
    found = vs.AirModel.of(one).at(width=1.4, blur=2.0)
    scenes = blurred(widened(one, 1.4), 2.0)
    places = np.random.default_rng(1).uniform(-8, 12, (50, 3))
    n = scenes.refractivity(places)
    np.testing.assert_allclose(found.refractivity(places), n, rtol=0, atol=1e-7)


def test_a_simplified_field_stays_simple(points):
    """Linear between nodes, or its section alone, after all transforms; derivatives likewise."""
    values = {name: value for name, value in VALUES.items() if name != "temperature"}
    for kind in (("linear", 3), ("cubic", 2)):
        flat = vs.AirModel.of(plume().simplified(*kind))
        air = flat.at(**values)
        assert (air.interpolation, air.dimensions) == kind
        by = flat.derivatives(["blur"], **values)["blur"]
        plus, minus = (flat.at(**{**values, "blur": 1.9 + e}) for e in (1e-3, -1e-3))
        difference = (plus.refractivity(points) - minus.refractivity(points)) / 2e-3
        atol = 1e-5 * abs(difference).max()
        np.testing.assert_allclose(by.refractivity(points), difference, rtol=0, atol=atol)


def test_what_it_does_not_have_is_refused(model):
    one = vs.AirModel.of(plume())
    for call, match in (
        (lambda: one.at(temperature=900.0), "temperature.*needs fields of several"),
        (lambda: one.at(widht=2.0), "no parameter 'widht'.*width"),
        (lambda: one.derivatives(["scales"]), "no parameter 'scales'.*scale"),
        (lambda: one.at(width=np.nan), "width is nan; give 0.1 to 10"),
        (lambda: one.at(scale="big"), "scale is 'big'"),
        (lambda: one.at(lean=60.0), "lean is 60.0; give -45 to 45"),
        (lambda: model.at(temperature=1300.0), "temperature is 1300.*882.5 to 1267.5 degC"),
        (lambda: vs.AirModel.of(None), "give an IndexField"),
        (lambda: vs.AirModel.of({900.0: plume()}), "two wall temperatures"),
        (lambda: vs.AirModel.of(plume(), temperature_c=900.0), "there is one field"),
        (lambda: vs.AirModel.of(model.fields, temperature_c=800.0), "from 882.5 to 1267.5 degC"),
    ):
        with pytest.raises(InputError, match=match):
            call()


def test_it_says_what_it_is_and_travels(model):
    air = model.at(width=1.25, offset=0.5, temperature=1000.0)
    assert air.source == "width 1.25, offset 0.5 mm, temperature 1000 degC"
    assert repr(model).startswith("AirModel: fields at 900, 1000, 1250 degC, scale, width, offset")
    again = pickle.loads(pickle.dumps(model))
    assert again == model
    units = {name: each.unit for name, each in model.parameters.items()}
    assert units["pressure"] == "Pa"
    assert units["offset"] == "mm"
    assert all(each.low <= each.start <= each.high for each in model.parameters.values())
