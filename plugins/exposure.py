"""Samples of pixels, chunk by chunk, averaged on a film."""

import math
import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from virtual_sensor_plugins.drift import Drift
from virtual_sensor_plugins.views import View

from virtual_sensor.arrays import in_own_memory
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError

ONE_FRAME = threading.RLock()
"""Held while a frame is made: hot and cold states of a scene, in any thread, share one film."""

Shade = Callable[[Any, Any, Any], tuple[Sequence[Any], Any]]
"""From rays, their rows among the pixels asked for, and their pixels to radiances and alpha.

The radiances are those of each frame; one alone is that of all.
"""

_UNDER_WAY = 4  # chunks at most: each takes memory
_VALUES = 1 << 26  # of all frames' samples in them, about
_STREAM = 1 << 20  # chunks of a stream at most
_GOLDEN = 0x9E3779B9  # seeds of chunks lie so far apart


def own_sampler(sensor: mi.Sensor, spp: int) -> mi.Sampler:
    """A sampler like the sensor's, of as many samples per pixel; 0: as many as it has."""
    sampler = sensor.sampler().fork()
    if spp:
        level = mi.logger().log_level()
        mi.logger().set_log_level(mi.LogLevel.Error)  # what is used in place of it is logged below
        try:
            sampler.set_sample_count(spp)
        finally:
            mi.logger().set_log_level(level)
    taken = sampler.sample_count()
    if taken != (spp or taken) or not taken:
        raise InputError(
            f"{spp} samples per pixel: the scene's <sampler> would take {taken}; give a number that"
            " it has (spp), such as 1, 4, 9 or 16"
        )
    return sampler


def shared_sampler(sampler: mi.Sampler, points: int) -> mi.Sampler:
    """The sampler of each of so many points that share a pixel's samples: a square number, or 1.

    Other samplers than the scenes' may have other numbers: theirs next to it is taken.
    """
    own = sampler.fork()
    own.set_sample_count(max(1, round(math.sqrt(sampler.sample_count() / points))) ** 2)
    return own


class Exposure:
    """Frames in the making, whose samples are of the same rays.

    Parameters
    ----------
    view : View
    sampler : mi.Sampler
        The frame's own: what another frame takes from the sensor's stays as it is.
    seed : int
    pixels : int
        How many will be exposed in all.
    progress : callable
        Called with the fraction done.
    on_film : bool
        Whether the sensor's film is exposed too: Mitsuba takes the image from there.
    frames : int
    passes : int
        Through so many points of a lens's pupil pixels are exposed, one after the other, and the
        image is the mean of all; 1: pixels that are exposed again are those of the last time.
    drift : Drift, optional
        What is on its way, and which rows are exposed; by default nothing, and all.
    """

    def __init__(
        self,
        view: View,
        sampler: mi.Sampler,
        seed: int,
        pixels: int,
        progress: Callable[[float], None] | None,
        on_film: bool = False,
        frames: int = 1,
        passes: int = 1,
        drift: Drift | None = None,
    ) -> None:
        self.drift = drift
        self.view, self.sampler, self.film = view, sampler, view.sensor.film()
        # Each pixel's samples are averaged in their order: added to the film one by one, as other
        # filters need it, the last bits would depend on which thread comes first.
        self._own_pixel = self.film.rfilter().is_box_filter()
        grey = len(mi.Spectrum()) == 1  # else the film makes its own of the colours
        self._blocks: list[Any] = []
        self._images: Any = None
        if on_film or not (self._own_pixel and grey):
            self.film.prepare([])
            self._blocks = [self.film.create_block() for _ in range(frames)]
        else:
            # NumPy's memory, which is in use only from where light is written.
            self._images = mi.Float(np.zeros(frames * view.pixels, np.float32))
        self._frames, self._passes, self._under_way = frames, passes, 0
        self._seed, self._pixels, self._progress = int(seed), pixels, progress
        self._done = 0

    def developed(self, frame: int = 0, develop: bool = True) -> Any:
        """Mitsuba's image of a frame, on the sensor's film; None if it is to stay there."""
        self.film.prepare([])
        self.film.put_block(self._blocks[frame])
        if not develop:
            return None
        image = self.film.develop()
        dr.eval(image)
        return image

    def brighten(self, image: NDArray[np.float32], frame: int = 0) -> None:
        """Add radiances (H, W) to a frame on the film."""
        tensor = self._blocks[frame].tensor()
        values = np.array(tensor)  # three colours, alpha if any, and the samples' weight
        weight = values[:, :, -1]
        weight[weight == 0.0] = 1.0
        values[:, :, :3] += (image * weight)[:, :, None]
        tensor[:] = type(tensor)(in_own_memory(values.ravel(), mi.Float), values.shape)

    def images(self) -> NDArray[np.float32]:
        """The radiances, (frames, H, W)."""
        shape = self._frames, self.view.height, self.view.width
        if not self.on_film:
            return self._images.numpy().reshape(shape)
        images = np.empty(shape, np.float32)
        for number, image in enumerate(images):
            developed = np.array(self.developed(number), np.float32)
            image[...] = developed.reshape(*image.shape, -1)[:, :, 0]
        return images

    @property
    def overwrites(self) -> bool:
        """Whether pixels that are exposed again are those of the last time; else they add up."""
        return not self._blocks and self._passes == 1

    @property
    def on_film(self) -> bool:
        """Whether samples are put on the film: each pixel needs as many in each pass."""
        return bool(self._blocks)

    def add(
        self,
        pixels: NDArray[np.uint32] | None,
        shade: Shade,
        lanes: int,
        stream: int = 0,
        through: View | None = None,
        shift: tuple[float, float] | None = None,
    ) -> None:
        """Expose pixels, or all of the film, with so many samples in flight at once.

        Those of another stream have other random numbers, whatever else is exposed.

        Parameters
        ----------
        pixels : ndarray of shape (N,), optional
        shade : Shade
        lanes, stream : int
        through : View, optional
            What the rays are of, where they are not the exposure's.
        shift : tuple of two float, optional
            By how much the samples are moved within their pixels, px.
        """
        view = through or self.view
        kept = None
        if self.drift is not None:
            pixels, kept = self._in_rows(pixels, self.drift.rows)
        total = self.view.pixels if pixels is None else pixels.size
        if not total:
            return
        spp = self.sampler.sample_count()
        numbers = None if pixels is None else in_own_memory(pixels, mi.UInt32)
        kept = None if kept is None else in_own_memory(kept, mi.UInt32)
        chunk = max(1, lanes // spp)
        most = min(max(_VALUES // (chunk * spp * self._frames), 1), _UNDER_WAY)
        for number, first in enumerate(range(0, total, chunk), stream * _STREAM):
            # What changes from chunk to chunk is opaque, so that one kernel serves them all.
            count = min(chunk, total - first)
            row = dr.repeat(dr.arange(mi.UInt32, count), spp) + dr.opaque(mi.UInt32, first)
            pixel = row if numbers is None else dr.gather(mi.UInt32, numbers, row)
            self.sampler.set_samples_per_wavefront(spp)
            shuffled = self._seed + number * _GOLDEN & 0xFFFFFFFF
            self.sampler.seed(dr.opaque(mi.UInt32, shuffled), count * spp)
            within = self.sampler.next_2d()
            if shift is not None:
                within = within + dr.opaque(mi.Point2f(*shift))
                within = within - dr.floor(within)
            if self.drift is not None:
                within = self.drift.within(within)
            place = self.view.place(pixel, within)
            lens = self.view.sensor.needs_aperture_sample()
            aperture = self.sampler.next_2d() if lens else mi.Point2f(0.5)
            ray, weight = view.rays(place, aperture)
            if self.drift is not None and kept is not None:
                row = dr.gather(mi.UInt32, kept, row)
                ray = self.drift.ray(ray, self.view.row_of(pixel))
            values, alpha = shade(ray, row, pixel)
            values = [value * weight for value in values]
            if self._blocks:
                self._put(place, values, alpha, pixel)
            else:
                self._average(values, pixel)
            self._under_way += 1
            if self._under_way >= most:  # the next ones are prepared meanwhile
                dr.sync_thread()
                self._under_way = 0
            self._done += count
            if self._progress:
                dr.sync_thread()
                self._progress(min(1.0, self._done / self._pixels))

    def _in_rows(
        self, pixels: NDArray[np.uint32] | None, rows: slice
    ) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
        """Those pixels that lie in rows of the film, and their places among those given."""
        if pixels is None:
            pixels = np.arange(self.view.pixels, dtype=np.uint32)
        row = self.view.row_of(pixels)
        kept = np.flatnonzero((row >= rows.start) & (row < rows.stop)).astype(np.uint32)
        return pixels[kept], kept

    def _average(self, values: list[Any], pixel: Any) -> None:
        """Average the samples of each pixel."""
        spp = self.sampler.sample_count()
        dr.eval(values)  # together: each by itself would follow all rays again
        own = dr.gather(mi.UInt32, pixel, dr.arange(mi.UInt32, dr.width(pixel) // spp) * spp)
        for frame, value in zip(range(self._frames), self._of_each(values), strict=True):
            place = own + dr.opaque(mi.UInt32, frame * self.view.pixels)
            mean = mi.Float((dr.block_sum(value, spp) / spp)[0])
            if self._passes > 1:  # each pixel once: the sum is that of the passes' order
                dr.scatter_add(self._images, mean / self._passes, place)
            else:
                dr.scatter(self._images, mean, place)
        dr.eval(self._images)

    def _put(self, place: Any, values: list[Any], alpha: Any, pixel: Any) -> None:
        """Put samples on the film."""
        alpha = dr.select(alpha, mi.Float(1.0), 0.0)
        if self._own_pixel:
            spp = self.sampler.sample_count()
            dr.eval(values, alpha)
            *values, alpha = (dr.block_sum(v, spp) / spp for v in (*values, alpha))
            own = dr.gather(mi.UInt32, pixel, dr.arange(mi.UInt32, dr.width(alpha)) * spp)
            place = self.view.place(own, mi.Point2f(0.5))
        for block, value in zip(self._blocks, self._of_each(values), strict=True):
            block.put(place, mi.Ray3f().wavelengths, value, alpha)
        dr.eval([block.tensor() for block in self._blocks])

    def _of_each(self, values: list[Any]) -> list[Any]:
        """The radiances of each frame."""
        return values * self._frames if len(values) == 1 else values
