"""Curves of made-up laser rays, in the paper's settings: no engine runs."""

import dataclasses

import numpy as np
from artificial import paper_sensor

from virtual_sensor.devices.sensor import SensorModel
from virtual_sensor.poses import Pose
from virtual_sensor.studies.reproduction.curves import METHODS, SEARCHED, Curve, Curves
from virtual_sensor.studies.reproduction.settings import ALL_BETAS_DEG, BLURRED, RESOLVED, Setting

NINE_MM = np.linspace(0.0, -10.0, 9)
RADIUS_MM = 13.5


def turned_sensor(beta_deg):
    """The paper's sensor, turned round the cylinder's axis."""
    c, s = np.cos(np.radians(beta_deg)), np.sin(np.radians(beta_deg))
    turn, axis = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]), np.array([0.0, 0.0, -RADIUS_MM])

    def turned(part):
        pose = Pose(turn @ part.pose.rotation, turn @ (part.pose.origin_mm - axis) + axis)
        return part.with_pose(pose)

    sensor = paper_sensor()
    return SensorModel(turned(sensor.camera), turned(sensor.laser))


def invented(setting, method, y_mm=NINE_MM):
    """Rays in the laser's plane whose spot moves, and whose pixels are bent, by smooth functions.

    Rendered pixels stray by a few thousandths; a rendered line has the search's u.
    """
    sensor = turned_sensor(setting.beta_deg)
    forward, along = sensor.laser.pose.rotation[:, 2], sensor.laser.pose.rotation[:, 1]
    centre = sensor.laser.pose.to_world([0.0, 0.0, 300.0])
    A = centre + y_mm[:, None] * along + (0.03 * y_mm**2)[:, None] * forward
    size = setting.temperature_c / 1250.0 / (1.0 + setting.beta_deg)
    B = A + size * 0.05 * np.stack([np.cos(y_mm / 4), np.sin(y_mm / 3), -np.sin(y_mm / 5)], axis=1)
    bent = size * np.stack([0.3 * y_mm, -1.0 + 0.02 * y_mm**2], axis=1)
    pixels = [sensor.camera.project(A), sensor.camera.project(B) + bent]
    if method != SEARCHED:
        stray = 0.004 * np.stack([np.sin(7.0 * y_mm), np.cos(9.0 * y_mm)], axis=1)
        known = [0.0, 1.0] if method == "rendered line" else [1.0, 1.0]
        pixels = [pixel + sign * stray * known for pixel, sign in zip(pixels, (1, -1), strict=True)]
    helper = np.where(method == SEARCHED, 0.5 + 0.04 * y_mm, np.nan)
    return Curve(setting, method, sensor, y_mm, A, B, pixels[0], pixels[1], helper)


POSES = [(t, b) for t in (900.0, 1100.0, 1250.0) for b in (0.0, 15.0, 30.0)]


def invented_curves():
    """All methods in the resolved air, the search alone in the blurred one."""
    settings = {air: [Setting(air, *pose) for pose in POSES] for air in (RESOLVED, BLURRED)}
    nine = {(s, method): invented(s, method) for s in settings[RESOLVED] for method in METHODS}
    nine |= {(s, SEARCHED): invented(s, SEARCHED) for s in settings[BLURRED]}
    line = np.linspace(-11.0, 11.0, 23)
    whole = {(s, SEARCHED): invented(s, SEARCHED, line) for s in settings[RESOLVED]}
    poses = [Setting(air, 1250.0, b) for air in settings for b in ALL_BETAS_DEG[::5]]
    return Curves(nine, whole, {(s, SEARCHED): invented(s, SEARCHED, line) for s in poses})


def only(curves, wanted):
    """The nine rays by some methods and in some settings alone."""
    nine = {key: curve for key, curve in curves.nine.items() if wanted(*key)}
    return dataclasses.replace(curves, nine=nine)
