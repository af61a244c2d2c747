"""Air between the wall temperatures that were computed: what a family of fields interpolates."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BarycentricInterpolator

from virtual_sensor.errors import InputError
from virtual_sensor.medium.field_family import FieldFamily
from virtual_sensor.medium.index_field import IndexField

AMBIENT = 2.7e-4
RANDOM = np.random.default_rng(7)


def field(nodes, spacing=2.0, ambient=AMBIENT):
    """A field about the origin, mirrored in x."""
    where = {"ambient": ambient, "mirror": (True, False, False)}
    return IndexField.from_arrays(nodes, [0.0, -3.0, -1.0], [1.0, spacing, 0.5], **where)


KNOWN = {t: field(AMBIENT * RANDOM.random((5, 4, 6))) for t in (1100.0, 900.0, 1250.0)}
BETWEEN = BarycentricInterpolator(list(KNOWN), [each.nodes for each in KNOWN.values()])


@pytest.mark.parametrize("temperature", [885.0, 900.0, 1013.0, 1100.0, 1249.0, 1250.0, 1267.0])
def test_every_node_follows_the_polynomial_through_its_values(temperature):
    """By SciPy's interpolator; at a temperature that was computed, the field that was."""
    found = FieldFamily(KNOWN).at(temperature)
    close = {"rtol": 0, "atol": 1e-13 * AMBIENT}
    np.testing.assert_allclose(found.nodes, BETWEEN(temperature), **close)
    if temperature in KNOWN:
        np.testing.assert_allclose(found.nodes, KNOWN[temperature].nodes, **close)
    np.testing.assert_array_equal(found.box, KNOWN[900.0].box)
    assert (found.ambient, found.mirror) == (AMBIENT, (True, False, False))


@pytest.mark.parametrize("temperature", [900.0, 1013.0, 1250.0])
def test_the_derivative_is_the_polynomials(temperature):
    """By central differences of SciPy's interpolator, exact for a parabola; outside it is zero."""
    found = FieldFamily(KNOWN).derivative(temperature)
    expected = (BETWEEN(temperature + 10.0) - BETWEEN(temperature - 10.0)) / 20.0
    np.testing.assert_allclose(found.nodes, expected, rtol=0, atol=1e-10 * abs(expected).max())
    np.testing.assert_array_equal(found.box, KNOWN[900.0].box)
    assert (found.ambient, found.mirror) == (0.0, (True, False, False))


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({900.0: KNOWN[900.0]}, "two wall temperatures at least"),
        (
            {900.0: KNOWN[900.0], 1250.0: field(np.zeros((5, 4, 5)))},
            "900 and 1250 degC differ in their grids",
        ),
        (
            {900.0: KNOWN[900.0], 1250.0: field(KNOWN[1250.0].nodes, spacing=2.1)},
            "900 and 1250 degC differ in their grids",
        ),
        (
            {900.0: KNOWN[900.0], 1250.0: replace(KNOWN[1250.0], mirror=(False, False, False))},
            "900 and 1250 degC differ in their grids",
        ),
        (
            {900.0: KNOWN[900.0], 1250.0: field(KNOWN[1250.0].nodes, ambient=2.6e-4)},
            "900 and 1250 degC have different surroundings",
        ),
    ],
    ids=["one", "shape", "spacing", "mirror", "ambient"],
)
def test_fields_that_do_not_fit_make_no_family(fields, complaint):
    """Rationale: node by node they would mix air of different places."""
    with pytest.raises(InputError, match=complaint):
        FieldFamily(fields)


def test_a_little_beyond_it_errs_no_more_than_between():
    """Rationale: a parabola through three fields errs by this product times a third derivative."""
    family = FieldFamily(KNOWN)
    t = np.linspace(*family.limits, 1001)
    error = abs(np.prod([t - each for each in KNOWN], axis=0))
    inside = (t >= 900.0) & (t <= 1250.0)
    assert 1.0 < (t.max() - 1250.0) < 20.0
    assert error[~inside].max() <= error[inside].max()


@pytest.mark.parametrize("temperature", [880.0, 1270.0, np.nan])
def test_beyond_what_was_computed_nothing_is_guessed(temperature):
    """Rationale: a parabola through three fields runs away outside them."""
    family = FieldFamily(KNOWN)
    for ask in (family.at, family.derivative):
        with pytest.raises(InputError, match=r"is not between 882\.5 and 1267\.5 degC"):
            ask(temperature)
