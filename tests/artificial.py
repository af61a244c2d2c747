"""Images of known truth, made with no help from the package, and the paper's sensor."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import erf

from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.devices.sensor import SensorModel
from virtual_sensor.optics.ray_families import Pinhole, Sheet
from virtual_sensor.poses import Pose


def line_image(centre, sigma, amplitude=1.0, background=0.0, height=64):
    """Image (height, W) of a Gaussian line, integrated over each pixel's height.

    `centre`, `sigma` and `amplitude` are scalars or one per column.  Independent of `line_centres`:
    written with erf over the pixel's edges.
    """
    centre, sigma, amplitude = np.broadcast_arrays(*np.atleast_1d(centre, sigma, amplitude))
    edges = np.arange(height + 1)[:, None] - 0.5
    primitive = np.sqrt(np.pi / 2.0) * sigma * erf((edges - centre) / (np.sqrt(2.0) * sigma))
    return background + amplitude * np.diff(primitive, axis=0)


def cramer_rao(sigma, noise_variance, centre=0.0):
    """Smallest rms error in px of the centre of a unit-amplitude line: physics.md, Line centres.

    `noise_variance` is a function of the expected grey value.
    """
    flux = np.sqrt(2.0 * np.pi) * sigma
    edges = np.arange(-60, 62) - 0.5 - centre
    expected = flux * np.diff(0.5 * erf(edges / sigma / np.sqrt(2.0)))
    slope = -np.diff(np.exp(-0.5 * (edges / sigma) ** 2))
    return np.sum(slope**2 / noise_variance(expected)) ** -0.5


def rendered_line(centre, sigma, amplitude=1.0, height=64, width=64, samples=4, cut=18.0):
    """Image of a Gaussian line as a renderer sees it: samples x samples midpoints in each pixel.

    `centre` is a function of u; the line is exactly zero farther than `cut` rows from its centre.
    """
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    u = (np.arange(width)[:, None] + offsets).ravel()
    v = (np.arange(height)[:, None] + offsets).ravel()
    across = v[:, None] - centre(u)
    fine = amplitude * np.exp(-(across**2) / (2.0 * sigma**2)) * (np.abs(across) <= cut)
    return fine.reshape(height, samples, width, samples).mean(axis=(1, 3))


def dot_image(centres, sigma, flux=1.0, shape=(64, 64), background=0.0):
    """Image of round Gaussian dots at pixels `centres` (M, 2), integrated over each pixel."""
    image = np.full(shape, float(background))
    for u, v in np.atleast_2d(centres):
        across = line_image(v, sigma, height=shape[0])[:, 0]
        along = line_image(u, sigma, height=shape[1])[:, 0]
        image += flux * across[:, None] * along / (2.0 * np.pi * sigma**2)
    return image


def paper_sensor(alpha_deg=60.0, fan_deg=0.0):
    """Sensor of Beermann et al. 2018, table 1: laser and camera at +-alpha/2 to the vertical."""
    return SensorModel(
        camera=Pinhole(
            matrix=np.array([[75 / 5.5e-3, 0, 1023.5], [0, 75 / 5.5e-3, 1023.5], [0, 0, 1]]),
            pose=_looking_at_origin(alpha_deg / 2.0, x_axis=(0.0, 1.0, 0.0)),
            size=(2048, 2048),
        ),
        laser=LaserLine(
            Sheet(
                pose=_looking_at_origin(-alpha_deg / 2.0, y_axis=(0.0, 1.0, 0.0)),
                distance_mm=300.0,
                fan_per_mm=2.0 * np.tan(np.radians(fan_deg) / 2.0) / 20.0,
            ),
            length_mm=20.0,
            radius_mm=0.15,
            power_w=0.1,
            dots_mm=np.array([]),
        ),
    )


def _looking_at_origin(tilt_deg, x_axis=None, y_axis=None):
    """Pose 300 mm from the origin in the xz plane, z towards the origin, x or y as given."""
    tilt = np.radians(tilt_deg)
    z = -np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    x = np.cross(y_axis, z) if x_axis is None else np.array(x_axis)
    return Pose(rotation=np.stack([x, np.cross(z, x), z], axis=1), origin_mm=-300.0 * z)


@dataclass(frozen=True)
class HeldScene:
    """What a search needs of a scene, without a renderer."""

    sensor: SensorModel
    medium: Any
    surface: Any

    @property
    def camera(self):
        return self.sensor.camera

    @property
    def source(self):
        return self.sensor.laser
