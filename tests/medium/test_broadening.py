"""Broadened air against Gaussians in closed form, and against itself unfolded."""

import numpy as np
import pytest

from virtual_sensor.errors import InputError
from virtual_sensor.medium.broadening import blurred, widened
from virtual_sensor.medium.index_field import IndexField

AMBIENT = 2.7e-4
SPACING = np.array([5.0, 0.5, 1.25])


def heat(field):
    """Sum of the difference from ambient over all space, mirrored parts too, mm^3."""
    weights = np.ones(field.shape)
    for axis, even in enumerate(field.mirror):
        if even:  # what lies in the mirror plane is there once, everything else twice
            twice = np.full(field.shape[axis], 2.0)
            twice[0] = 1.0
            weights *= np.expand_dims(twice, [a for a in range(3) if a != axis])
    return (weights * (field.nodes - field.ambient)).sum() * field.spacing.prod()


def places(field, axis):
    """Positions of the nodes along an axis, mm."""
    return field.origin[axis] + field.spacing[axis] * np.arange(field.shape[axis])


def hill(mirror=(False, False, False), width_mm=(4.0, 10.0), centre_mm=(0.0, 0.0)):
    """A Gaussian hill in y and z that fades out well inside its box, varying along x."""
    y = SPACING[1] * np.arange(0 if mirror[1] else -60, 61)
    z = SPACING[2] * np.arange(0 if mirror[2] else -48, 49)
    along = np.array([1.0, 0.7, 0.9, 0.2])[:, None, None]
    across = ((y - centre_mm[0]) / width_mm[0])[:, None] ** 2
    across = across + ((z - centre_mm[1]) / width_mm[1]) ** 2
    values = AMBIENT - 2e-4 * along * np.exp(-across / 2.0)
    origin = [0.0, y[0], z[0]]
    return IndexField.from_arrays(
        values, origin, SPACING, ambient=AMBIENT, mirror=mirror, source="a hill"
    )


@pytest.mark.parametrize("sigma_mm", [1.5, 7.0])
def test_a_blurred_gaussian_is_a_wider_gaussian(sigma_mm):
    """Rationale: variances add along y and along z, x stays; the one case known in closed form."""
    field = blurred(hill(centre_mm=(1.3, -2.1)), sigma_mm)
    new = np.hypot([4.0, 10.0], sigma_mm)
    y, z = (places(field, axis) - c for axis, c in ((1, 1.3), (2, -2.1)))
    along = np.array([1.0, 0.7, 0.9, 0.2])[:, None, None]
    shape = np.exp(-((y / new[0])[:, None] ** 2 + (z / new[1]) ** 2) / 2.0)
    expected = -2e-4 * along * shape * 4.0 * 10.0 / new.prod()
    largest = abs(expected).max()
    # Cut off at 4 standard deviations, a Gaussian lacks 6e-5 of its weight, and 1e-3 of its
    # variance.
    np.testing.assert_allclose(field.nodes - AMBIENT, expected, atol=6e-4 * largest)


@pytest.mark.parametrize("mirror", [(False, True, False), (True, True, True)])
def test_a_mirrored_field_is_blurred_like_the_unfolded_one(mirror):
    """Rationale: a plume's middle is the mirror plane; heat must come back across it."""
    folded, whole = (blurred(hill(m), 6.0) for m in (mirror, (False, False, False)))
    kept = tuple(slice(-n, None) for n in folded.shape)
    np.testing.assert_allclose(folded.nodes, whole.nodes[kept], atol=1e-12 * AMBIENT)
    assert folded.mirror == mirror
    np.testing.assert_allclose(folded.box[:, 1:], whole.box[:, 1:])


@pytest.mark.parametrize("mirror", [(False, False, False), (False, True, False)])
def test_heat_is_kept_and_nothing_is_left_at_the_border(mirror):
    """Rationale: a blur spreads hot air and makes none.

    Even where a plume leaves through the top, as in the shipped fields: outside is the air
    of the surroundings, and the jump is gone.  Along x nothing is spread, and its border stays.
    """
    before = hill(mirror, centre_mm=(0.0, 55.0))
    after = blurred(before, 7.0)
    assert before.border_jump()[5] > 1e-4
    assert heat(after) == pytest.approx(heat(before), rel=1e-12)
    assert after.border_jump()[2:].max() < 1e-12 * AMBIENT
    assert after.border_jump()[1] > 0.0
    reach = 4 * 7.0
    assert np.all(after.box[1, 1:] - before.box[1, 1:] >= reach)
    assert after.box[0, 2] <= before.box[0, 2] - reach
    assert after.origin[1] == (0.0 if mirror[1] else pytest.approx(after.box[0, 1]))
    np.testing.assert_array_equal(after.box[:, 0], before.box[:, 0])


def test_no_broadening_changes_nothing():
    """Rationale: the default of every scene must cost nothing and leave every bit."""
    field = hill()
    assert blurred(field, 0.0) is field
    assert widened(field, 1.0) is field


def test_a_widened_field_has_its_values_elsewhere():
    """Rationale: n at (x, y, z) is the former n at (x, y/k, z), so that the middle stays hot."""
    field = hill((True, True, False), centre_mm=(0.0, 3.0))
    wide = widened(field, 3.4)
    p = np.random.default_rng(1).uniform([0.0, -25.0, -40.0], [14.0, 25.0, 40.0], (50, 3))
    stretched = p * [1.0, 3.4, 1.0]
    np.testing.assert_allclose(wide.refractivity(stretched), field.refractivity(p), rtol=1e-12)
    assert heat(wide) == pytest.approx(3.4 * heat(field), rel=1e-12)


def test_a_widened_field_that_is_not_about_zero_is_stretched_about_zero():
    """Rationale: a whole field's box starts left of y = 0; that end moves outward too."""
    field = hill(centre_mm=(2.0, 0.0))
    wide = widened(field, 2.0)
    np.testing.assert_allclose(wide.box[:, 1], [-60.0, 60.0])
    p = [[5.0, 4.0, 0.0]]
    assert wide.refractivity(p)[0] == pytest.approx(AMBIENT - 1.4e-4, rel=1e-12)


def test_the_source_tells_of_it():
    """Rationale: nobody shall take broadened air for a computed one."""
    assert blurred(widened(hill(), 2.0), 7.5).source == (
        "a hill, widened 2 times along y, blurred by 7.5 mm"
    )


@pytest.mark.parametrize("sigma_mm", [-1.0, np.nan, np.inf, 61.0])
def test_an_unfit_blur_is_refused(sigma_mm):
    """Rationale: one wider than the field would fill the memory with nothing."""
    with pytest.raises(InputError, match=r"blur: the standard deviation is .* at most 60 mm"):
        blurred(hill(), sigma_mm)


@pytest.mark.parametrize("factor", [0.0, -2.0, np.nan, np.inf])
def test_an_unfit_factor_is_refused(factor):
    """Rationale: a plume of no width has no gradient."""
    with pytest.raises(InputError, match="widen: the factor is"):
        widened(hill(), factor)
