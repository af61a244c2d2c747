"""The air that a scene may have."""

import shutil

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.optics.bent_points import bent_points
from virtual_sensor.optics.rays import March
from virtual_sensor.studies.air_models import air_model_of

VALUES = {
    "temperature": 1180.0,
    "width": 1.1,
    "offset": 0.7,
    "height": -1.2,
    "scale": 1.05,
    "pressure": 96e3,
    "blur": 1.4,
}
STEPS = {"temperature": 2.0, "pressure": 200.0, "width": 1e-3, "scale": 2e-3}
MARCH = March(0.5, "leapfrog")  # whose kernels compile quickly
Y = np.array([-9.3, -4.1, 0.7, 5.2, 9.1])
PIXEL = np.column_stack([1024 + 48.0 * Y, 1024.0 + 2.0 * Y**2])


@pytest.fixture(scope="module")
def scene():
    return vs.load_scene("hot_cylinder", beta=10)


def test_a_scene_of_several_temperatures_has_a_family(scene):
    """Its own field is the default; what it makes of its air it makes of all."""
    model = air_model_of(scene)
    assert [*model.fields.fields] == [900.0, 1100.0, 1250.0]
    assert model.at() is scene.medium
    wide = vs.load_scene("stepped_shaft", temperature=1100, widen=1.5, blur=2)
    assert air_model_of(wide).at() is wide.medium
    hottest = vs.load_scene("stepped_shaft", temperature=1250, widen=1.5, blur=2).medium
    places = [[0.0, 3.0, 20.0], [10.0, -8.0, 60.0]]
    found = air_model_of(wide).at(temperature=1250.0).refractivity(places)
    np.testing.assert_allclose(found, hottest.refractivity(places), rtol=1e-12)


def test_points_follow_every_parameter_of_the_air(scene):
    """Against bent points in the air before and after, of a mirrored quarter field."""
    fields = air_model_of(scene).fields.fields.items()
    every = np.array([4, 2, 2])
    model = vs.AirModel.of(
        {t: f.with_nodes(f.nodes[::4, ::2, ::2], f.origin, every * f.spacing) for t, f in fields}
    )
    here = scene.with_medium(model.at(**VALUES))
    found = bent_points(here, PIXEL, variations=model.derivatives(VALUES, **VALUES), march=MARCH)
    for name, by in found.point_by.items():
        e = STEPS.get(name, 0.01)
        ends = [model.at(**{**VALUES, name: VALUES[name] + s * e}) for s in (1, -1)]
        plus, minus = (
            bent_points(scene.with_medium(end), PIXEL, march=MARCH).point_mm for end in ends
        )
        difference = (plus - minus) / (2.0 * e)
        atol = 1e-4 * abs(difference).max()
        np.testing.assert_allclose(by, difference, rtol=0, atol=atol, err_msg=name)
    assert list(found.point_by) == list(VALUES)


def test_without_relatives_there_is_one_field(tmp_path):
    """Of fields that are given, or named otherwise, or whose neighbours are of another grid."""
    fields = shipped_scenes() / "fields"
    one = vs.load_scene("hot_cylinder").with_medium(fields / "hot_cylinder_900C_quarter.nc")
    assert "temperature" not in air_model_of(one).names
    for name in ("hot_1250.nc", "hot_12500.nc", "cold_900.nc"):
        shutil.copy(fields / "hot_cylinder_1250C_quarter.nc", tmp_path / name)
    shape = (5, 6, 7)
    other = vs.IndexField.from_arrays(np.full(shape, 2.7e-4), [0, 0, 0], [1, 1, 1])
    other.write(tmp_path / "hot_900.nc")
    (tmp_path / "hot_1100.nc").write_text("no field")
    alone = vs.load_scene("hot_cylinder", field=tmp_path / "hot_1250.nc")
    (tmp_path / "hot_12500.nc").unlink()
    model = air_model_of(alone)
    assert "temperature" not in model.names
    assert model.at() is alone.medium


def test_cold_scenes_have_no_air_to_vary(scene):
    with pytest.raises(InputError, match=r"light runs straight.*give the scene a field"):
        air_model_of(scene.cold())
