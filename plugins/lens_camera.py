"""The sensor `lens_camera`: a camera as it is built."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from virtual_sensor_plugins.properties import (
    distortion_of,
    finite,
    folders_of_files,
    listed_file,
    numbers_in,
    optional,
    optional_positive,
    pose_of,
    refuse_both,
)
from virtual_sensor_plugins.views import OURS_FROM_MITSUBAS, View, camera_of

from virtual_sensor.devices.camera import MM_PER_UM, LensCamera, tilt_of, with_tilt
from virtual_sensor.devices.exposure_time import exposure_time_s
from virtual_sensor.devices.image_sensor import ImageSensor, image_sensor, image_sensors
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError, naming
from virtual_sensor.optics.lens import USUAL_SUB_PUPILS, Lens
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.undistortion import check_unfolded
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

LASER_PLANE = "laser_plane"
"""The tilt that focuses the plane of the only laser: of the whole scene alone it can be told."""

_SHIFTS = "principal_point_offset_x", "principal_point_offset_y"
_OF_PERSPECTIVE = "fov", "fov_axis", "near_clip", "far_clip", *_SHIFTS
_NOT_ALWAYS = "fov", "fov_axis", "focus_distance", "focal_length", *_SHIFTS
_SAME = 1e-6  # of two lengths that say the same, but for typed digits
_NEAR_MM, _FAR_MM = 1e-2, 1e4  # Mitsuba's


class LensCameraSensor(mi.Sensor):
    """A camera with a lens and a sensor; without these it is Mitsuba's `perspective`, to the bit.

    Left out are the fall of light towards the corners (vignetting, cos^4), diffraction where there
    is no speckle, aberrations other than distortion, colour, and lens breathing: with a given image
    distance or field of view, focusing changes the focal length and not the field of view.

    ========================  =========  =======================================================
    Property                  Default    Meaning
    ========================  =========  =======================================================
    to_world                  (needed)   Where it stands: z forward, x left, y up; with a
                                         calibration it may be left out
    fov                       (needed)   Field of view, degrees; in its place image_distance with
                                         pixel, or a calibration
    fov_axis                  "x"        Of the field of view: "x", "y", "diagonal", "smaller" or
                                         "larger"
    image_distance            (none)     From the lens to the sensor, mm; with a field of view or a
                                         calibration it follows from pixel
    pixel                     (none)     Pitch of the pixels, um; by default the sensor_model's
    principal_point_offset_x  0          By which part of the film's width it is moved
    principal_point_offset_y  0          By which part of its height
    distortion                ""         OpenCV's coefficients, "k1, k2, p1, p2, k3 ...": 4, 5, 8,
                                         12 or 14 of them; empty: none
    calibration               ""         File of the camera's matrix, distortion and size as OpenCV
                                         and ROS write it; where to_world is left out, of its pose
    tilt                      ""         Of the sensor, degrees: about x (the image's rows), or
                                         "about x, about y", OpenCV's tau_x and tau_y; or
                                         "laser_plane": as the only laser's plane is in focus
    f_number                  ""         Focal length by the pupil's diameter; empty or 0: a pinhole
    focus_distance            (none)     From the lens to what is in focus along the axis, mm
    focal_length              (none)     Of the lens, F of 1/F = 1/b + 1/g, mm; in place of the
                                         image_distance b, or of the focus_distance g
    sub_pupils                16         Points of the pupil that a frame is rendered through; 1:
                                         only its middle, without blur
    transmission              1          Part of the light that the lens lets through
    sensor_model              ""         Image sensor that frames are recorded with: a name or a
                                         data sheet, TOML; empty: none
    exposure                  ""         Time of an exposure, such as 2ms or 500us; empty: automatic
    near_clip                 0.01       Nothing nearer is seen by other integrators than
                                         `refractive`, mm
    far_clip                  10000      Nothing farther is seen, mm
    ========================  =========  =======================================================
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        width, height = (int(n) for n in self.film().size())
        self.ideal = None
        self._near = float(props.get("near_clip", _NEAR_MM))
        self._far = float(props.get("far_clip", _FAR_MM))
        for name in _NOT_ALWAYS:  # by what else is given
            if name in props:
                props.mark_queried(name)
        with naming("lens_camera"):
            if "fov" in props and not str(props.get("calibration", "")):
                self.ideal = self._perspective(props)
            self.camera, self.focuses_laser = _built(props, (width, height), self.ideal)
        self.m_needs_sample_3 = self.camera.lens is not None
        if self.camera.lens or self.camera.distorts:
            self.ideal = None

    def _perspective(self, props: mi.Properties) -> mi.Sensor:
        """Mitsuba's own, whose numbers in float32 are this one's."""
        if "to_world" not in props:
            raise InputError("the property 'to_world' is missing; give where it stands")
        given = {name: props[name] for name in _OF_PERSPECTIVE if name in props}
        given |= {"to_world": props["to_world"], "film": self.film(), "sampler": self.sampler()}
        return mi.load_dict({"type": "perspective", **given})

    def focus_laser(self, normal: Array, offset_mm: float) -> None:
        """Tilt the sensor as a laser's plane is in focus, normal . x = offset."""
        with naming("lens_camera: 'tilt' is laser_plane"):
            self.camera = self.camera.focused_on(normal, offset_mm)
            check_unfolded(self.camera)
        self.ideal = None

    def sample_ray(
        self, time: Any, colour: Any, place: Any, aperture: Any, active: Any = True
    ) -> tuple[Any, Any]:
        """A straight ray through a place of the film's crop window, and its weight.

        For other integrators; it leaves the pupil where the sample of the aperture is.
        """
        if self.ideal is not None:
            ray, weight = self.ideal.sample_ray(time, colour, place, aperture, active)
            return ray, weight
        film, camera = self.film(), self.camera
        place = place * mi.Point2f(film.crop_size()) + mi.Point2f(film.crop_offset())
        ray, _ = View(self, camera.chief).rays(place, aperture)
        wavelengths, weight = self.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), colour)
        x, y, z = (mi.Vector3f(*axis.tolist()) for axis in camera.pose.rotation.T)
        heading, origin = ray.d / dr.dot(ray.d, z), mi.Point3f(ray.o)
        if camera.lens:
            p, q = dr.dot(heading, x), dr.dot(heading, y)
            disc = mi.warp.square_to_uniform_disk_concentric(aperture)
            ax, ay = (float(camera.lens.pupil_radius_mm) * each for each in (disc.x, disc.y))
            sharp = camera.lens.in_focus(p, q)
            origin = origin + x * ax + y * ay
            heading = heading - x * (ax * sharp) - y * (ay * sharp)
        length, start = dr.norm(heading), mi.Point3f(origin + heading * self._near)
        ray = mi.Ray3f(start, mi.Vector3f(heading / length), time, wavelengths)
        ray.maxt = (self._far - self._near) * length
        return ray, weight

    def parameters_changed(self, keys: list[str]) -> None:
        """Take over a film whose crop window was changed."""
        if self.ideal is not None:
            self.ideal.parameters_changed(keys)

    def near_clip(self) -> float:
        """Nothing nearer is seen by other integrators than ours, mm."""
        return self._near

    def far_clip(self) -> float:
        """Nothing farther is seen, mm."""
        return self._far

    def to_string(self) -> str:
        """Its own values, for Mitsuba's scene listing."""
        return f"LensCameraSensor[{self.camera}]"


def _built(
    props: mi.Properties, size: tuple[int, int], ideal: mi.Sensor | None
) -> tuple[LensCamera, bool]:
    """The camera that an element describes, and whether it is to focus the laser's plane."""
    sensor = _image_sensor(str(props.get("sensor_model", "")))
    pixel_um = optional_positive(props, "pixel", "the pitch of the pixels in um")
    pixel_um = pixel_um or (sensor.pixel_um if sensor else None)
    image_mm = optional_positive(props, "image_distance", "a length in mm")
    rays = _rays(props, size, ideal, image_mm, pixel_um)
    focal_px = abs(float(rays.matrix[0, 0]))
    if pixel_um is None:
        pixel_um = image_mm / focal_px / MM_PER_UM if image_mm else None
    elif image_mm and abs(image_mm / (focal_px * pixel_um * MM_PER_UM) - 1.0) > _SAME:
        raise InputError(
            f"'image_distance' is {image_mm:g} mm, and the field of view with pixels of"
            f" {pixel_um:g} um makes it {focal_px * pixel_um * MM_PER_UM:.6g} mm; give one of them"
        )
    points = optional(props, "sub_pupils", "a whole number")
    points = USUAL_SUB_PUPILS if points is None else int(points) if points % 1.0 == 0.0 else points
    lets = optional_positive(props, "transmission", "a part, above 0 and up to 1") or 1.0
    tilt = str(props.get("tilt", "")).strip()
    f_number = optional(props, "f_number", "an f-number, such as 8; 0 or empty for a pinhole")
    camera = LensCamera.of(
        rays,
        sub_pupils=points,
        pixel_um=pixel_um,
        sensor=sensor,
        exposure_s=exposure_time_s("'exposure'", props.get("exposure", "")),
        transmission=lets,
    )
    if f_number:
        lens = _lens(props, camera.image_distance_mm, f_number)
        pixel_um = pixel_um or lens.image_distance_mm / focal_px / MM_PER_UM
        camera = replace(camera, lens=lens, pixel_um=pixel_um)
    elif "focal_length" in props:
        raise InputError("has a 'focal_length' and no 'f_number'; give it that too")
    of_distortion = tilt_of(camera)
    if tilt and any(of_distortion):
        raise InputError(
            "has a 'tilt', and its distortion has one too (tau_x, tau_y: the last coefficients);"
            " give one of them"
        )
    if tilt != LASER_PLANE:
        angles = _tilt(tilt) if tilt else of_distortion
        camera = with_tilt(camera, angles) if any(angles) else camera
    check_unfolded(camera)
    return camera, tilt == LASER_PLANE


def _rays(
    props: mi.Properties,
    size: tuple[int, int],
    ideal: mi.Sensor | None,
    image_mm: float | None,
    pixel_um: float | None,
) -> Pinhole:
    """The chief rays: by a calibration, a field of view, or an image distance."""
    distortion = distortion_of(str(props.get("distortion", "")))
    if name := str(props.get("calibration", "")):
        from virtual_sensor.devices.calibration_files import (  # which few scenes have
            CalibrationFile,
            camera_in,
        )

        refuse_both(props, "calibration", _SHIFTS)
        if distortion.size:
            raise InputError("has a 'calibration' and a 'distortion'; give one of them")
        file = listed_file("calibration", name)
        camera = camera_in(CalibrationFile.read(file))
        if camera.size != size:
            (width, height), (w, h) = camera.size, size
            raise InputError(
                f"{file}: is of {width} x {height} px, and the <film> has {w} x {h}; give the film"
                " that size, or calibrate for this one"
            )
        return camera.with_pose(_pose(props)) if "to_world" in props else camera
    if ideal is not None:
        perspective = camera_of(ideal)
        assert perspective is not None
        return replace(perspective.chief, distortion=distortion)
    if image_mm is None or pixel_um is None:
        raise InputError(
            "has no field of view; give 'fov' in degrees, 'image_distance' in mm with 'pixel' in"
            " um, or a 'calibration'"
        )
    if "fov_axis" in props:
        raise InputError("has a 'fov_axis' and no 'fov' that it is of; take it out")
    shift = np.array([finite(props, name, 0.0) for name in _SHIFTS])
    focal_px, centre = image_mm / (pixel_um * MM_PER_UM), np.array(size) * (0.5 - shift) - 0.5
    matrix = np.array([[focal_px, 0.0, centre[0]], [0.0, focal_px, centre[1]], [0.0, 0.0, 1.0]])
    return Pinhole(matrix, _pose(props), size, distortion)


def _pose(props: mi.Properties) -> Pose:
    """In our convention: x along u, y along v, z forward."""
    if "to_world" not in props:
        raise InputError("the property 'to_world' is missing; give where it stands")
    pose = pose_of(props, "'fov'")
    return Pose(pose.rotation @ OURS_FROM_MITSUBAS, pose.origin_mm)


def _lens(props: mi.Properties, image_mm: float | None, f_number: float) -> Lens:
    """The lens: two of its focal length F, image distance b and focus distance g."""
    of_mm = "a length in mm"
    focal_mm = optional_positive(props, "focal_length", of_mm)
    focus_mm = optional_positive(props, "focus_distance", of_mm)
    if focal_mm and focus_mm and not image_mm:
        image_mm = _conjugate("focus_distance", focus_mm, focal_mm)
    elif focal_mm and image_mm and not focus_mm:
        focus_mm = _conjugate("image_distance", image_mm, focal_mm)
    elif focal_mm and image_mm and focus_mm:
        by_lens_mm = _conjugate("focus_distance", focus_mm, focal_mm)
        if abs(by_lens_mm / image_mm - 1.0) > _SAME:
            raise InputError(
                f"'focal_length' {focal_mm:g} mm and 'focus_distance' {focus_mm:g} mm put the"
                f" sensor {by_lens_mm:.6g} mm behind the lens, and it is at {image_mm:.6g} mm;"
                " leave one of them out"
            )
    if image_mm is None or focus_mm is None:
        missing = "'pixel' in um, or 'image_distance'" if image_mm is None else "'focus_distance'"
        raise InputError(f"has an 'f_number', and its lens lacks {missing} in mm; give it")
    return Lens.of_f_number(image_mm, focus_mm, f_number)


def _conjugate(name: str, length_mm: float, focal_mm: float) -> float:
    """The other distance of 1/F = 1/b + 1/g."""
    if not length_mm > focal_mm:
        raise InputError(
            f"'{name}' is {length_mm:g} mm, and a lens of {focal_mm:g} mm ('focal_length') focuses"
            " nowhere at its focal length or nearer; give a longer distance"
        )
    return 1.0 / (1.0 / focal_mm - 1.0 / length_mm)


def _tilt(text: str) -> tuple[float, float]:
    """Two angles in degrees that a text lists, or the first of them."""
    angles = numbers_in(text)
    if angles is None or len(angles) not in (1, 2):
        raise InputError(
            f"'tilt' is \"{text[:80]}\"; give an angle about x in degrees, two about x and about"
            f" y with a comma, or {LASER_PLANE}"
        )
    return float(angles[0]), float(angles[1]) if len(angles) == 2 else 0.0


def _image_sensor(name: str) -> ImageSensor | None:
    """The image sensor of a name, or of a file beside the scene."""
    if not name:
        return None
    beside = (folder / name for folder in folders_of_files() if name not in image_sensors())
    return image_sensor(next((file for file in beside if file.is_file()), name))


mi.register_sensor("lens_camera", LensCameraSensor)
