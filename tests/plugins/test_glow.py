"""A hot part's glow: off unless asked for, Planck's law in the image, and no harm to the line."""

import numpy as np
import pytest

from virtual_sensor.devices.planck import band_radiance
from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.render import arrangement, render, render_frame
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.imaging.scene_file import find_scene
from virtual_sensor.metrology.line_peaks import line_centres

FILM = {"width": 256, "height": 256, "spp": 4, "line_radius": 0.8}


@pytest.fixture(scope="module")
def glowing():
    return load_scene("hot_cylinder", emissivity=0.8, **FILM)


def test_without_emissivity_the_frame_is_that_of_the_laser_alone():
    """Off by default: the same samples, on the pixels that the laser reaches and no others."""
    scene = load_scene("hot_cylinder", **FILM)
    frame = render_frame(scene)
    assert arrangement(scene).glow == 0.0
    assert np.mean(frame.radiance > 0.0) < 0.1
    assert check_scene(scene) == []


def test_beside_the_line_the_image_shows_plancks_radiance(glowing):
    """Every pixel of the part, to the float32 of the image; the air behind it is black."""
    image = render(glowing)
    expected = 0.8 * band_radiance(532.0, 10.0, 1250.0)
    dark = image[:20, 118:138]  # on the cylinder, away from the line
    np.testing.assert_allclose(dark, expected, rtol=1e-3)
    assert image[128, 2] == 0.0


def test_the_glow_does_not_move_the_line(glowing):
    """Even light on both sides: centres within 1e-4 px of those without."""
    without = line_centres(render(load_scene("hot_cylinder", **FILM)))
    seen = line_centres(render(glowing))
    both = np.isfinite(without.row) & np.isfinite(seen.row)
    assert both.sum() > 100
    np.testing.assert_allclose(seen.row[both], without.row[both], atol=1e-4)


def test_the_cold_part_does_not_glow(glowing):
    """In homogeneous air the part is taken as cold; another transport changes nothing."""
    assert np.mean(render(glowing.cold()) > 0.0) < 0.1
    assert glowing.with_transport(glowing.transport.by("straight")).hot


def test_beside_a_lamp_the_cold_part_does_not_glow_either(tmp_path):
    """A lamp has all pixels looked at, and what they see is no emitter unless the part is hot."""
    emitter = '<emitter type="point"><point name="position" x="0" y="0" z="300"/></emitter></scene>'
    path, air = tmp_path / "lamp.xml", load_scene("hot_cylinder").air.path
    text = find_scene("hot_cylinder").read_text(encoding="utf-8")
    path.write_text(text.replace("</scene>", emitter), encoding="utf-8")
    glowing, dull = (load_scene(path, field=air, emissivity=share, **FILM) for share in (0.8, 0.0))
    part = np.s_[:20, 118:138]
    lamp = render(dull)[part].mean()
    assert render(glowing.cold())[part].mean() == pytest.approx(lamp, rel=0.01)
    hot = lamp + 0.8 * band_radiance(532.0, 10.0, 1250.0)
    assert render(glowing)[part].mean() == pytest.approx(hot, rel=0.01)


def test_the_user_is_told_how_bright_it_is(glowing):
    """A line in the measurement's notes."""
    (told,) = check_scene(glowing)
    assert "glows with 4.4e-07 W/(mm^2 sr)" in told


def test_a_stock_integrator_wastes_no_samples_on_it(glowing):
    """One sample a pixel finds the line: of four lights in the scene one lights the part."""
    direct = mi.load_dict({"type": "direct"})
    glow = 0.8 * band_radiance(532.0, 10.0, 1250.0)
    few, many = (np.array(direct.render(glowing.mitsuba, spp=spp)) > 10.0 * glow for spp in (1, 16))
    assert many.sum() > 100
    assert few.sum() > 0.9 * many.sum()


@pytest.mark.parametrize(
    ("emissivity", "says"), [("1.5", "'emissivity' is 1.5"), ("-1", "'emissivity' is -1")]
)
def test_what_can_not_be_is_refused(emissivity, says):
    """By the file, the element and the remedy."""
    with pytest.raises(InputError, match=says) as told:
        load_scene("hot_cylinder", emissivity=emissivity, **FILM)
    assert "hot_cylinder.xml" in str(told.value)
