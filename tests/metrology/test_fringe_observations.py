"""Decoded fringes in blocks: beside the maps that they were drawn from, and a search of rays."""

from dataclasses import replace

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.metrology.fringes.observations import decoded_blocks
from virtual_sensor.optics.rays import March

SIGMA_PX = 0.05
SIDE = 256
QUICK = March(0.5, "leapfrog", "double")


def decoded_as(column, row, sigma, status):
    """What a decoder gives, of these maps."""
    sigmas = [None if each is None else sigma.astype(np.float32) for each in (column, row)]
    nothing = np.zeros(status.shape, np.float32)
    rest = {"modulation": nothing, "mean": nothing, "phase": {}, "size_px": (1280, 800)}
    return vs.DecodedFringes(column, row, *sigmas, status=status, **rest)


def drawn(u, v):
    """A column and a row, smooth as of a round part."""
    column = 600 + 0.47 * u - 0.02 * v + 3e-5 * u * v - 1e-5 * u**2 + 2e-8 * u**3
    return column, 200 + 0.45 * v + 0.01 * u - 2e-5 * v**2


def image(seed=0, wrong=0.0):
    """The drawn maps with noise, a corner that is not decoded, and a share of wrong orders."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:SIDE, :SIDE].astype(float)
    column, row = (c + rng.normal(0.0, SIGMA_PX, c.shape) for c in drawn(u, v))
    column = column + 16.0 * (rng.random(column.shape) < wrong)
    status = np.zeros(column.shape, np.uint8)
    status[:80, :64] = 2
    column[:40, :64] = np.nan  # where there is none; below, a value that is not to be used
    column[40:80, :64] = 0.3 * u[40:80, :64]
    sigma = np.full(column.shape, SIGMA_PX)
    return decoded_as(column, row, sigma, status)


def test_blocks_are_as_sure_as_they_say_whatever_orders_are_wrong():
    """Rationale: an estimate's weights are these sigmas, and one wrong order would spoil a mean."""
    found = decoded_blocks(image(wrong=0.01), blocks=300)
    error = found.decoded_px - np.stack(drawn(*found.pixel.T), axis=1)
    assert 200 < len(found.pixel) <= 300
    assert not ((found.pixel < [60, 76]).all(axis=1)).any()
    assert 0.85 < (error / found.sigma_px).std() < 1.15
    assert found.sigma_px.max() < SIGMA_PX / 2
    np.testing.assert_allclose(found.slopes[:, 0, 0], 0.47, atol=0.04)


def test_a_depth_edge_makes_no_block():
    """Rationale: a mean over two faces lies on neither."""
    for at in (97, 100):  # through the middle of blocks, and near their edge
        there = image()
        there.column[:, at:] += 7.0
        there.row[:, at:] += 3.0
        found = decoded_blocks(there, blocks=300)
        error = found.decoded_px - np.stack(drawn(*found.pixel.T), axis=1)
        error -= np.where(found.pixel[:, :1] >= at, [7.0, 3.0], 0.0)
        assert np.abs(error).max() < 6 * found.sigma_px.max() < 3 * SIGMA_PX


@pytest.fixture(scope="module")
def searched():
    """A hot scene of few pixels, and what each sees of the projector's image, by a search."""
    scene = vs.load_scene("fringe_cylinder", width=48, height=48)
    v, u = np.mgrid[:48, :48]
    found = vs.projector_pixels(scene, np.stack([u.ravel(), v.ravel()], axis=1), march=QUICK)
    column, row = np.moveaxis(found.projector_pixel.reshape(48, 48, 2), -1, 0)
    sigma = np.full(column.shape, 0.01)
    status = np.where(np.isfinite(column), 0, 2).astype(np.uint8)
    return scene, decoded_as(column, row, sigma, status)


def test_the_air_is_found_from_the_epipolar_residual_alone(searched):
    """Rationale: no shape is known or sought, and the true air is the model's with 1 and 0."""
    scene, decoded = searched
    seen = vs.fringe_observation(scene, decoded)
    found = vs.estimate_air(seen, scene.medium, ["scale", "width", "offset"])
    assert found.shape is None
    for name, true in (("scale", 1.0), ("width", 1.0), ("offset", 0.0)):
        assert abs(found[name] - true) < 1e-3
    straight = vs.estimate_air(seen, None, [])
    assert straight.rms_px > 0.05 > 1e-3 > found.rms_px  # of 1 mm


def test_noise_is_in_the_cameras_pixels():
    """Rationale: an estimate weighs residuals in px of the camera, on whose pixels 0.46 fall."""
    decoded = image()
    scene = vs.load_scene("fringe_cylinder", width=SIDE, height=SIDE)
    seen = vs.fringe_observation(scene, decoded, blocks=300)
    of_projector = decoded_blocks(decoded, blocks=300).sigma_px.mean(axis=1)
    np.testing.assert_allclose(seen.sigma_px, of_projector / 0.46, rtol=0.1)
    alone = vs.fringe_observation(scene, replace(decoded, row=None), blocks=300)
    of_projector = decoded_blocks(replace(decoded, row=None), blocks=300).sigma_px[:, 0]
    np.testing.assert_allclose(alone.sigma_px, of_projector / 0.47, rtol=0.1)


def test_a_column_alone_is_measured_across_its_fringes(searched):
    """Rationale: then the noise has a direction, and a shape is needed."""
    scene, decoded = searched
    alone = replace(decoded, row=None)
    seen = vs.fringe_observation(scene, alone, name="columns")
    assert seen.along_mm is None
    across = np.abs(np.sin(np.radians(seen.normal_deg)))
    assert across.min() > 0.6  # the camera sees the columns as rows
    lens = replace(scene.projector.family, distortion=np.array([-5.0, 0.0, 0.0, 0.0]))
    bent = replace(scene, sources={"projector": replace(scene.projector, family=lens)})
    s = vs.fringe_observation(bent, alone).coordinate
    middle = lens.project(lens.rays(s, np.zeros(len(s)))[0] + 300.0 * lens.rays(s, 0.0 * s)[1])
    np.testing.assert_allclose(middle[:, 0], decoded_blocks(alone).decoded_px[:, 0], atol=1e-3)
    with pytest.raises(InputError, match="without a shape"):
        vs.estimate_air(seen, scene.medium, ["scale"])


def test_what_can_not_be_used_is_named(searched):
    """Rationale: no traceback, and the remedy."""
    scene, decoded = searched
    laser = vs.load_scene("hot_cylinder")
    none = replace(decoded, column=None)
    blind = replace(decoded, column=np.full_like(decoded.column, np.nan))
    for here, what, words in (
        (laser, decoded, "no pixels"),
        (scene, none, "along u"),
        (scene, blind, "no block"),
        (scene, decoded.column, "DecodedFringes"),
        (scene, replace(decoded, size_px=(1024, 768)), "1024 x 768 px"),
        (scene, replace(decoded, absolute=False), "in time"),
        (vs.load_scene("fringe_cylinder", width=50, height=48), decoded, "48 x 48 px"),
    ):
        with pytest.raises(InputError, match=words):
            vs.fringe_observation(here, what)
