"""Layers of a frame's light: direct, by bounce, and which rays make the ghosts."""

from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
from matplotlib.figure import Figure

import virtual_sensor as vs
from virtual_sensor.imaging.layers import GhostStatus, GhostTruth
from virtual_sensor.imaging.render import Frame, PixelTruth, RenderReport, write_exr
from virtual_sensor.studies.ghosts import ghost_facts

HEIGHT, WIDTH = 12, 8
LINE_ROW, GHOST_ROW = 3, 9


def layered(ghost=0.1, bounces=2):
    """A frame of a line in one row and its ghost in another, of rays (0.1, 2) and (-0.1, 4)."""
    direct = np.zeros((HEIGHT, WIDTH), np.float32)
    direct[LINE_ROW], direct[LINE_ROW + 1] = 2.0, 1.0
    moments = np.zeros((bounces, 5, HEIGHT, WIDTH), np.float32)
    for (s, t), part in (((0.1, 2.0), 0.75), ((-0.1, 4.0), 0.25)):
        light = part * ghost * 2.0
        moments[0, :, GHOST_ROW, : WIDTH // 2] += np.array(
            [light, light * s, light * t, light * s * s, light * t * t], np.float32
        )[:, None]
    index = np.flatnonzero(direct).astype(np.uint32)
    point = np.zeros((index.size, 3), np.float32)
    truth = PixelTruth(
        index,
        point,
        np.full(index.size, 300.0, np.float32),
        {"laser": np.zeros((index.size, 2), np.float32)},
        {"laser": np.zeros(index.size, np.uint8)},
        RenderReport("straight"),
    )
    background = np.full_like(direct, 0.5)
    indirect = moments[:, 0]
    radiance = direct + indirect.sum(axis=0) + background
    ghosts = GhostTruth.of({"laser": moments})
    rest = background, direct, indirect, ghosts
    return Frame(radiance, truth, {"laser": 0.15}, RenderReport("straight"), *rest)


def test_a_ghost_knows_its_rays_and_their_spread():
    """By the moments of two rays, three parts and one: mean and standard deviation of each."""
    frame = layered()
    st = frame.ghost_coordinates(1)
    np.testing.assert_allclose(st[GHOST_ROW, 0], [0.05, 2.5], rtol=1e-6)
    spread = np.array([0.2, 2.0]) * np.sqrt(0.75 * 0.25)
    np.testing.assert_allclose(frame.ghosts.spread["laser"][0, 0], spread, rtol=1e-5)
    lit = np.zeros((HEIGHT, WIDTH), bool)
    lit[GHOST_ROW, : WIDTH // 2] = True
    np.testing.assert_array_equal(np.isfinite(st), np.stack([lit, lit], -1))
    assert np.isnan(frame.ghost_coordinates(2, "laser")).all()
    status = frame.ghosts.status["laser"]
    np.testing.assert_array_equal(status[0], GhostStatus.LIT)
    np.testing.assert_array_equal(status[1], GhostStatus.DARK)
    assert (
        repr(frame.ghosts)
        == "GhostTruth: light of laser, 4 pixels by 1 bounce, 0 pixels by 2 bounces"
    )
    assert "2 bounces" in repr(frame)
    with pytest.raises(vs.InputError, match="bounce must be a whole number from 1 to 2"):
        frame.ghost_coordinates(3)
    with pytest.raises(vs.InputError, match="max_depth=3"):
        vs.render_frame("cold_cylinder", spp=1).ghost_coordinates()


def test_a_frame_without_ghosts_says_so():
    """A flat part: the layers are there, and dark."""
    ghosts = GhostTruth.of({"laser": np.zeros((1, 5, HEIGHT, WIDTH))})
    assert ghosts.index.size == 0
    assert ghosts.bounces == 1
    assert len(ghosts.to_dataframe()) == 0
    assert GhostTruth.of({}).bounces == 0
    columns = layered(ghost=0.0).ghost_columns
    assert columns.seen.sum() == 0
    assert np.isnan(columns.ghost_row_px).all()
    assert vs.render_frame("cold_cylinder", spp=1).ghost_columns is None


def test_ghosts_are_counted_beside_their_line_by_column():
    """A tenth of the line in half of the columns; where it is under the line it is none."""
    columns = layered(ghost=0.1).ghost_columns
    np.testing.assert_allclose(columns.over_line, [0.1] * 4 + [0.0] * 4, rtol=1e-6)
    np.testing.assert_array_equal(columns.ghost_row_px[:4], GHOST_ROW)
    assert columns.seen.sum() == 4
    assert repr(columns) == "GhostColumns: ghosts in 4 of 8 columns, up to 0.1 of the line"
    assert layered(ghost=0.009).ghost_columns.seen.sum() == 0


def test_what_is_said_of_ghosts_is_of_all_columns_of_the_line():
    """Ghosts of 0.1 to 0.4 of the line in half of eight columns, none in the others."""
    frame = layered(ghost=0.1)
    brighter = np.concatenate([np.arange(1, 5), np.ones(4)]).astype(np.float32)
    found = ghost_facts(replace(frame, indirect=frame.indirect * brighter))
    assert (found.bounces, found.columns, found.ghost_columns) == (2, 8, 4)
    assert found.ghost_over_line == pytest.approx(0.05)
    assert found.largest_ghost_over_line == pytest.approx(0.3 + 0.1 * (0.95 * 7.0 - 6.0))
    assert found.indirect_share == pytest.approx(2.0 / (24.0 + 2.0))
    assert ghost_facts(replace(frame, direct=None, indirect=None)) is None


def test_layers_are_channels_of_the_exr_file(tmp_path):
    """Read back by OpenEXR, and by `read_image` under the channels' names."""
    frame = layered()
    write_exr(tmp_path / "frame.exr", frame, {})
    with OpenEXR.File(str(tmp_path / "frame.exr"), separate_channels=True) as file:
        held = {name: channel.pixels for name, channel in file.channels().items()}
    layers = "direct.Y", "indirect1.Y", "indirect2.Y", "background.Y"
    np.testing.assert_allclose(sum(held[name] for name in layers), held["Y"], rtol=1e-6)
    for bounce in (1, 2):
        names = (f"laser.indirect{bounce}.{axis}" for axis in "ab")
        st = np.stack([held[name] for name in names], -1)
        np.testing.assert_array_equal(st, frame.ghost_coordinates(bounce))
    read = vs.read_image(tmp_path / "frame.exr", "indirect1.Y")
    np.testing.assert_array_equal(read, frame.indirect[0])


def test_a_frame_with_layers_is_drawn_with_its_ghosts_in_colour():
    """The window holds the ghost too, and the light in between has a colour of its own."""
    axes = Figure().add_subplot()
    layered().plot(axes)
    assert axes.get_legend() is not None
    grey, tint = axes.images
    assert tint.get_array()[..., 3].max() > 0.2
    assert grey.get_extent()[2] >= GHOST_ROW + 0.5
