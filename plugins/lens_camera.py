"""The sensor `lens_camera`: a camera as it is built."""

from typing import Any

from virtual_sensor_plugins.views import camera_of

from virtual_sensor.engine import mi

_OF_PERSPECTIVE = (
    *("fov", "fov_axis", "near_clip", "far_clip"),
    *("principal_point_offset_x", "principal_point_offset_y"),
)


class LensCameraSensor(mi.Sensor):
    """A camera with a lens and a sensor; without these it is Mitsuba's `perspective`, to the bit.

    ========================  =========  =======================================================
    Property                  Default    Meaning
    ========================  =========  =======================================================
    to_world                  (needed)   Where it stands: z forward, x left, y up
    fov                       (needed)   Field of view, degrees
    fov_axis                  "x"        Of the field of view: "x", "y", "diagonal", "smaller" or
                                         "larger"
    principal_point_offset_x  0          By which part of the film's width it is moved
    principal_point_offset_y  0          By which part of its height
    near_clip                 0.01       Nothing nearer is seen by other integrators than
                                         `refractive`, mm
    far_clip                  10000      Nothing farther is seen, mm
    ========================  =========  =======================================================
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        given = {name: props[name] for name in _OF_PERSPECTIVE if name in props}
        self.ideal = mi.load_dict(
            {
                "type": "perspective",
                "to_world": props["to_world"],
                "film": self.film(),
                "sampler": self.sampler(),
                **given,
            }
        )
        self.camera = camera_of(self.ideal)
        self.m_needs_sample_3 = False

    def sample_ray(
        self, time: Any, wavelengths: Any, place: Any, aperture: Any, active: Any = True
    ) -> tuple[Any, Any]:
        """A straight ray through a place of the film's crop window, and its weight."""
        ray, weight = self.ideal.sample_ray(time, wavelengths, place, aperture, active)
        return ray, weight

    def far_clip(self) -> float:
        """Nothing farther is seen, mm."""
        return float(self.ideal.far_clip())

    def to_string(self) -> str:
        """Its own values, for Mitsuba's scene listing."""
        return f"LensCameraSensor[{self.camera}]"


mi.register_sensor("lens_camera", LensCameraSensor)
