"""Where light folds or is shadowed, each pixel says so, and has no truth."""

import numpy as np
import pytest
from scipy.optimize import brentq

import virtual_sensor as vs
from virtual_sensor.imaging.render import lit_pixels
from virtual_sensor.optics.illumination import LightStatus
from virtual_sensor.optics.ray_search import incidence_points

FILM = {"width": 256, "height": 256, "spp": 4, "line_radius": 0.3}


def contrasted(scene, factor):
    """The scene in air that differs from its surroundings so many times as much."""
    air = scene.field
    nodes = air.ambient + factor * (air.nodes - air.ambient)
    return scene.with_medium(air.with_nodes(nodes))


def unlit(scene):
    """Statuses of the pixels that may be lit; those that are not must have no truth."""
    found = lit_pixels(scene)
    (status,), (place,) = found.status.values(), found.source_coordinates.values()
    assert np.isnan(place[status != LightStatus.LIT]).all()
    assert np.isnan(found.point_mm[status != LightStatus.LIT]).all()
    return status


@pytest.fixture(scope="module")
def first_fold():
    """Contrast from which on the laser line on the part runs back over itself.

    Rationale: independent of any status: incidence points of ever larger b go back in y.
    """
    scene = vs.load_scene("hot_cylinder")

    def least_step(factor):
        y = incidence_points(contrasted(scene, factor), np.linspace(-11.0, 11.0, 701))[:, 1]
        return float(np.diff(y[np.isfinite(y)]).min())

    return brentq(least_step, 10.0, 20.0, rtol=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("transport", ["marched", "tabulated"])
def test_no_fold_goes_unreported(first_fold, transport):
    """Where neighbouring rays cross, pixels are FOLDED; far below that contrast, none is."""
    scene = vs.load_scene("hot_cylinder", transport=transport, **FILM)
    assert not np.any(unlit(contrasted(scene, 0.6 * first_fold)) == LightStatus.FOLDED)
    assert np.any(unlit(contrasted(scene, 1.05 * first_fold)) == LightStatus.FOLDED)


def test_what_a_shoulder_hides_is_shadowed():
    """The stepped shaft's ledge stands between the laser and a part of what the camera sees."""
    status = unlit(vs.load_scene("stepped_shaft", **FILM))
    assert np.sum(status == LightStatus.SHADOWED) > 100
    assert set(status) <= {LightStatus.LIT, LightStatus.SHADOWED, LightStatus.NO_POINT}
