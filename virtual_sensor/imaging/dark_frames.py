"""Why a frame stays black though its geometry is sound: the cause is found and named."""

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import to_numpy
from virtual_sensor.engine import mi
from virtual_sensor.imaging.checks import SeenSurface, lit_line
from virtual_sensor.imaging.scene import Scene

Array = NDArray[np.float64]


def why_dark(scene: Scene) -> str:
    """The cause of a black frame and its remedy, in a sentence that starts with the element.

    Straight light is followed from the camera to the laser's line on the part, and what the part
    sends back is asked of its material there.
    """
    camera = scene.sensor.camera
    line = lit_line(scene)
    shown = camera.inside(camera.project(line.points_mm))
    points = line.points_mm[shown]
    depth_mm = camera.pose.to_local(points)[:, 2]
    return (
        _clipped(scene, depth_mm)
        or _unanswered(scene, points, line.y_mm[shown])
        or _missed(scene, points)
    )


def _clipped(scene: Scene, depth_mm: Array) -> str:
    sensor = scene.mitsuba_camera
    far, near = float(sensor.far_clip()), float(sensor.near_clip())
    for name, limit, cut in (
        ("far_clip", far, depth_mm >= far),
        ("near_clip", near, depth_mm <= near),
    ):
        if cut.all():
            return (
                f"{scene.camera_element}: {name} is {limit:g} mm, and the laser's line lies"
                f" {depth_mm.min():.4g} to {depth_mm.max():.4g} mm in front of the camera, which is"
                " cut off; change it"
            )
    return ""


def _unanswered(scene: Scene, points_mm: Array, y_mm: Array) -> str:
    """Why the surface at points of the line, at y along it, sends no light to the camera."""
    seen = SeenSurface.of(scene, points_mm, y_mm)
    if not seen.reached.any():
        return (
            "<shape>: something stands between the camera and the laser's line all along; take it"
            " away, or turn the camera (to_world, alpha)"
        )
    if np.any(seen.sent[seen.reached] > 0.0):
        return ""
    shape, si, reached = seen.shape(scene), seen.interaction, seen.reached
    material, part = f'<bsdf id="{shape.bsdf().id()}">', f'<shape id="{shape.id()}">'
    kinds = np.bitwise_or.reduce(np.array(si.bsdf().flags())[reached])
    if not kinds & int(mi.BSDFFlags.Smooth):
        what = "lets light through" if kinds & int(mi.BSDFFlags.Transmission) else "is a mirror"
        return (
            f"{material}: it {what}, and sends none of the laser's light to the camera; give it a"
            " rough surface (diffuse, roughconductor)"
        )
    normal, shading = to_numpy(si.n)[reached], to_numpy(si.sh_frame.n)[reached]
    sides = [np.einsum("ij,ij->i", normal, d[reached]) < 0.0 for d in (seen.toward, seen.light)]
    if not np.any(sides[0] & sides[1]):
        return (
            f"{part}: camera and laser are not both in front of its faces, which have no back; if"
            " they are turned inside out, reverse the order of their corners, or put the <bsdf>"
            ' into <bsdf type="twosided">'
        )
    if not np.any(np.einsum("ij,ij->i", normal, shading) > 0.0):
        return (
            f"{part}: its vertex normals are nil or point into it; compute them again, or set"
            " face_normals"
        )
    return (
        f"{material}: it reflects nothing of the laser's light to the camera; raise its reflectance"
    )


def _missed(scene: Scene, points_mm: Array) -> str:
    """The line is lit, but no sample met it."""
    camera, width_mm = scene.sensor.camera, 2.0 * scene.sensor.laser.radius_at(points_mm)
    width_px = float(np.mean(width_mm / camera.pixel_mm(points_mm)))
    if scene.medium and width_px > 1.0:
        return (
            '<integrator type="refractive">: by straight light the line is seen, and no bent ray'
            " finds it through this field; change the field, or how it is marched (step, transport)"
        )
    return (
        f"{scene.source_element}: no sample of the frame met the line, which is {width_px:.2g}"
        " px wide; give a wider or longer one (line_radius, line_length), or more samples (spp)"
    )
