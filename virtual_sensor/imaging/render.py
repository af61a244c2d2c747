"""Frames: what the camera records, with the ground truth of every pixel that the laser lights."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
from numpy.typing import NDArray
from virtual_sensor_plugins.exposure import ONE_FRAME
from virtual_sensor_plugins.lit_pixels import Account
from virtual_sensor_plugins.refractive import laser_of

from virtual_sensor.arrays import whole_number
from virtual_sensor.engine import dr, mi
from virtual_sensor.files import written_whole
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.optics.sight import check_scene_given

Image = NDArray[np.float32]

_MOST_SAMPLES = 1 << 20  # a pixel's are in flight at once
_LARGEST_SEED = 2**32 - 1


@dataclass(frozen=True)
class Frame:
    """A rendered frame, and the truth at its pixels' centres.

    Attributes
    ----------
    radiance : ndarray of shape (H, W)
        W/(mm^2 sr), averaged over each pixel.
    point_mm : ndarray of shape (H, W, 3)
        Where the bent line of sight meets the surface, world; NaN where the laser does not reach.
    depth_mm : ndarray of shape (H, W)
        Of that point along the camera's axis.
    laser_mm : ndarray of shape (H, W, 2)
        Coordinates (a, b), across the sheet and along the line, of the laser ray that lights it.
    lit : ndarray of shape (H, W)
        Whether the laser reaches the pixel's centre.
    account : Account
        How the frame was made: the transport, the tables' fineness and error, samples marched.
    """

    radiance: Image
    point_mm: Image
    depth_mm: Image
    laser_mm: Image
    lit: NDArray[np.bool_]
    account: Account


def render(scene: Scene, spp: int | None = None, seed: int = 0) -> Image:
    """Render the scene's camera image: radiance in W/(mm^2 sr), shape (H, W).

    Parameters
    ----------
    scene : Scene
    spp : int, optional
        Samples per pixel; the scene's own if not given.
    seed : int
        Of the sampler; the scenes that come along sample on a regular grid, whatever the seed.

    Raises
    ------
    InputError
        If it is no scene, or one of the numbers can't be used.
    EngineError
        If the scene was loaded under another Mitsuba variant.
    """
    samples, seed = _checked("render", scene, spp, seed)
    sensor = scene.mitsuba.sensors()[0]
    return _first_channel(scene.integrator.render(scene.mitsuba, sensor, seed, samples))


def _checked(asker: str, scene: Scene, spp: int | None, seed: int) -> tuple[int, int]:
    """Samples a pixel, 0 for the scene's own, and seed."""
    check_scene_given(asker, scene)
    laser_of(scene.mitsuba)
    samples = 0 if spp is None else whole_number(f"{asker}: spp", spp, 1, _MOST_SAMPLES)
    return samples, whole_number(f"{asker}: seed", seed, 0, _LARGEST_SEED)


def _first_channel(image: Any) -> Image:
    """Mitsuba's image (H, W, C) as an array (H, W)."""
    height, width = image.shape[:2]
    return np.array(image, np.float32).reshape(height, width, -1)[:, :, 0]


def render_frame(
    scene: Scene,
    spp: int | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Frame:
    """Render the scene's camera image together with its ground truth.

    `progress` is told the fraction of the samples done.  Raises as `render` does.
    """
    samples, seed = _checked("render_frame", scene, spp, seed)
    camera = scene.sensor.camera
    width, height = camera.size
    sensor = scene.mitsuba.sensors()[0]
    with ONE_FRAME:
        lit = scene.integrator.lit_pixels(scene.mitsuba, sensor)
        image = scene.integrator.render(
            scene.mitsuba, sensor, seed, samples, lit=lit, progress=progress
        )

    light = lit.sight.light
    a, b = light.s.numpy(), light.t.numpy()
    reached = (scene.integrator.irradiance(scene.mitsuba, light) > 0.0).numpy()
    point = np.array(lit.sight.point)
    depth = camera.pose.to_local(point.T)[:, 2]
    # Channel by channel, as files want it.  Dr.Jit has the memory: new one takes 0.1 s to fill.
    truth = dr.opaque(mi.Float, np.nan, 6 * height * width).numpy().reshape(6, -1)
    index = np.asarray(lit.index)[reached]
    for channel, values in zip(truth, (*point, depth, a, b), strict=True):
        channel[index] = values[reached]
    is_lit = np.zeros(height * width, bool)
    is_lit[index] = True
    channels = truth.reshape(6, height, width)
    return Frame(
        _first_channel(image),
        np.moveaxis(channels[:3], 0, -1),
        channels[3],
        np.moveaxis(channels[4:], 0, -1),
        is_lit.reshape(height, width),
        lit.account,
    )


def write_exr(path: Path, frame: Frame, header: dict[str, str]) -> None:
    """Write radiance and ground truth as float32 channels, with the scene's parameters as header.

    Channels: Y (radiance), point.X/Y/Z, depth.Z, laser.a, laser.b, lit.
    """
    channels = {
        "Y": frame.radiance,
        "point.X": frame.point_mm[:, :, 0],
        "point.Y": frame.point_mm[:, :, 1],
        "point.Z": frame.point_mm[:, :, 2],
        "depth.Z": frame.depth_mm,
        "laser.a": frame.laser_mm[:, :, 0],
        "laser.b": frame.laser_mm[:, :, 1],
        "lit": frame.lit.astype(np.float32),
    }
    attributes = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    pixels = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    with written_whole(path) as temporary:
        OpenEXR.File(attributes, pixels).write(str(temporary))


def write_png(path: Path, radiance: Image, white: float) -> None:
    """Write radiance as 16-bit grey, with `white` at the top of the range."""
    grey = np.clip(np.rint(radiance / white * 65535.0), 0, 65535).astype(np.uint16)
    coded, data = cv2.imencode(".png", grey, [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not coded:
        raise OSError(f"{path}: OpenCV can't encode the PNG")
    with written_whole(path) as temporary:
        temporary.write_bytes(data.tobytes())
