"""A camera's straight rays through its film."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import in_own_memory, to_numpy
from virtual_sensor.devices.camera import MM_PER_UM, LensCamera
from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.lens import Lens
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.surfaces import SceneSurface
from virtual_sensor.optics.undistortion import Undistortion
from virtual_sensor.poses import Pose

OURS_FROM_MITSUBAS = np.diag([-1.0, -1.0, 1.0])
"""Mitsuba's camera has x to the left and y up; ours has x along u and y along v, with z forward."""

Array = NDArray[np.float64]

THIN_LENS_FILM_MM = 36.0
"""Width of a `thinlens`'s film, which has none: Mitsuba's focal lengths are of such a film."""

_ON_BORDER = 33  # places along a side of the film whose rays bound those of all


def camera_of(sensor: mi.Sensor) -> LensCamera | None:
    """The camera of a sensor: of a `lens_camera`, or Mitsuba's `perspective` or `thinlens`.

    None of any other.
    """
    if hasattr(sensor, "camera"):  # of a plugin over one
        return sensor.camera
    if sensor.class_name() not in ("PerspectiveCamera", "ThinLensCamera"):
        return None
    held = mi.traverse(sensor)
    width, height = (int(n) for n in sensor.film().size())
    focal_px = width / 2.0 / np.tan(np.radians(float(np.ravel(held["x_fov"])[0])) / 2.0)
    names = (f"principal_point_offset_{axis}" for axis in "xy")  # which no thinlens has
    shift_x, shift_y = (float(np.ravel(held[n])[0]) if n in held else 0.0 for n in names)
    # Mitsuba's pixel i reaches from i to i + 1, ours has its centre at i; its shift moves the film.
    centre = (width * (0.5 - shift_x) - 0.5, height * (0.5 - shift_y) - 0.5)
    matrix = np.array([[focal_px, 0.0, centre[0]], [0.0, focal_px, centre[1]], [0.0, 0.0, 1.0]])
    to_world = np.array(sensor.world_transform().matrix, float).reshape(-1)[:16].reshape(4, 4)
    pose = Pose.from_matrix(to_world)
    turned = Pose(pose.rotation @ OURS_FROM_MITSUBAS, pose.origin_mm)
    if sensor.class_name() == "PerspectiveCamera":
        return LensCamera(matrix, turned, (width, height))
    pixel_um = THIN_LENS_FILM_MM / width / MM_PER_UM
    radius_mm, focus_mm = (
        float(np.ravel(held[name])[0]) for name in ("aperture_radius", "focus_distance")
    )
    lens = Lens(focal_px * pixel_um * MM_PER_UM, focus_mm, radius_mm)
    return LensCamera(matrix, turned, (width, height), lens=lens, pixel_um=pixel_um)


class View:
    """Straight rays of a camera through its film.

    A pinhole's are made of its numbers, and start at the projection centre, not at Mitsuba's near
    plane: where a camera stands in hot air, light bends in between.

    Parameters
    ----------
    sensor : mitsuba.Sensor
        With the film; its rays are taken where there is no `camera`.
    camera : Pinhole or None
        A point of a lens's pupil is one too.
    window : tuple of two slice, optional
        Rows and columns of the film's crop window; by default all of it.
    """

    def __init__(
        self,
        sensor: mi.Sensor,
        camera: Pinhole | None,
        window: tuple[slice, slice] | None = None,
    ) -> None:
        film = sensor.film()
        self.sensor, self.camera = sensor, camera
        self.width, self.height = (int(n) for n in film.crop_size())
        self._corner, self._across = mi.Point2f(film.crop_offset()), self.width
        self.offset = np.array(film.crop_offset(), int)
        if window is not None:
            rows, columns = window
            self.width, self.height = columns.stop - columns.start, rows.stop - rows.start
            self.offset += [columns.start, rows.start]
            # Each window has others, and one kernel serves them all.
            self._corner = dr.opaque(mi.Point2f(*map(float, self.offset)))
            self._across = dr.opaque(mi.UInt32, self.width)
        if camera is None:
            return
        frame = FamilyFrame.of(camera, mi.Array3f)
        self._axes = frame.x, frame.y, frame.z
        self._far = dr.opaque(mi.Float, float(sensor.far_clip()))
        self._origin = dr.opaque(mi.Array3f(*map(float, camera.pose.origin_mm)))
        matrix = camera.ideal_matrix
        inverse = np.linalg.inv(matrix[:2, :2]).ravel()
        numbers = [*(matrix[:2, 2] + 0.5), *inverse]  # Mitsuba's half pixel
        self._numbers = [dr.opaque(mi.Float, float(n)) for n in numbers]
        self._undistortion = Undistortion(camera) if camera.distorts else None

    @property
    def pixels(self) -> int:
        """How many there are."""
        return self.width * self.height

    def place(self, index: Any, within: Any) -> Any:
        """Place in px on the whole film of points within pixels, both coordinates from 0 to 1.

        Pixels are numbered by rows within the film's crop window.
        """
        corner = mi.Point2f(mi.Float(index % self._across), mi.Float(index // self._across))
        return corner + self._corner + within

    def row_of(self, index: Any) -> Any:
        """Rows of the whole film that hold pixels, of NumPy's numbers as of Dr.Jit's."""
        top = int(self.sensor.film().crop_offset()[1])
        if isinstance(index, np.ndarray):
            return (index // np.uint32(self.width)).astype(float) + top
        return mi.Float(index // dr.opaque(mi.UInt32, self.width)) + dr.opaque(mi.Float, top)

    def rays(self, place: Any, aperture: Any) -> tuple[Any, Any]:
        """Straight rays through places on the film, and their weights."""
        if self.camera is None:
            size = self.sensor.film().crop_size()
            in_window = (place - self._corner) / mi.Point2f(size)
            ray, weight = self.sensor.sample_ray(0.0, 0.5, in_window, aperture)
            return ray, weight
        u0, v0, a, b, c, d = self._numbers
        u, v = place.x - u0, place.y - v0
        if self._undistortion:
            by_u, by_v = self._undistortion.at(place)
            u, v = u + by_u, v + by_v
        x, y, z = self._axes
        slope = x * (a * u + b * v) + y * (c * u + d * v) + z
        ray = mi.Ray3f(mi.Point3f(self._origin), mi.Vector3f(dr.normalize(slope)))
        ray.maxt = self._far * dr.norm(slope)
        return ray, mi.Spectrum(1.0)

    def centres(self, pixels: NDArray[np.uint32] | None = None) -> Any:
        """Rays through the centres of pixels; of all without their numbers."""
        middle = mi.Point2f(0.5)
        if pixels is None:
            index = dr.arange(mi.UInt32, self.pixels)
        else:
            index = in_own_memory(pixels, mi.UInt32)
        return self.rays(self.place(index, middle), middle)[0]

    @property
    def corners(self) -> tuple[Array, Array]:
        """Lowest and highest (p, q) of the film's border, each of shape (2,)."""
        first = self.offset - 0.5
        last = first + np.array([self.width, self.height])
        assert self.camera is not None
        count = _ON_BORDER if self.camera.distorts else 2
        sides = np.stack(np.meshgrid(*np.linspace(first, last, count).T), axis=-1)
        p, q = self.camera.of_pixels(sides)
        return np.array([p.min(), q.min()]), np.array([p.max(), q.max()])

    @cached_property
    def pitch(self) -> float:
        """Angle between rays of pixels side by side, in the middle of the film, rad."""
        if self.camera is not None:
            pq = self.camera.of_pixels(self.camera.matrix[:2, 2])
            by_pq = np.linalg.inv(self.camera.pixel_slopes(*pq))
            return float(np.linalg.norm(by_pq, axis=0).max())
        middle = self.pixels // 2 + self.width // 2
        one, other = to_numpy(self.centres(np.array([middle, middle + 1], np.uint32)).d)
        return float(np.linalg.norm(one - other))


@dataclass(frozen=True)
class StraightSight:
    """What a camera would see if light ran straight.

    Attributes
    ----------
    view : View
    surface : SceneSurface
    """

    view: View
    surface: SceneSurface

    @cached_property
    def distance(self) -> Any:
        """From the camera along the rays of all pixels, mm; infinite where they meet nothing."""
        ray = self.view.centres()
        met = self.surface.distance(mi.Array3f(ray.o), mi.Array3f(ray.d), ray.maxt, True)
        dr.eval(met)
        return met
