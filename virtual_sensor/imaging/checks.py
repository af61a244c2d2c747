"""Whether a scene can be measured: checked before any light is followed through the field."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import to_vectors
from virtual_sensor.devices.device import irradiance
from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.devices.patterns import Uniform
from virtual_sensor.devices.projector import Projector
from virtual_sensor.display import Displayed
from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError, naming
from virtual_sensor.imaging.field_solid import REFUSED, wrong_scale
from virtual_sensor.imaging.part_survey import facet_error_mm
from virtual_sensor.imaging.render import arrangement
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.index_field import IndexField, border_of
from virtual_sensor.optics.field_border import (
    JUMP_REFUSED_PX,
    JUMP_TOLD_PX,
    BorderCrossing,
    border_crossing,
)
from virtual_sensor.optics.lens import circle_of_confusion
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.ray_search import SearchStatus, ray_search
from virtual_sensor.optics.sensor_geometry import NEAREST_MM, SINGULAR, check_geometry
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

FACETS_TOLD_PX = 0.03
"""Facets that lie beside their surface by more than this are noted."""

FOCUS_TOLD_PX = 5.0
"""Light whose blur is wider than this wherever a camera sees it is noted."""

FACETS_LIE = "the part's facets lie"
"""How the note of facets begins."""

FAINT = 1e-3
"""Of the brightest point of a line: what sends less is lost in a camera of 10 to 12 bits."""

_SAME_MM = 0.1  # float32 and facets apart
_FAINT_TOLD = 0.1  # of a line: so much of it that is faint is noted
_CELLS_FAR = 3.0  # diagonals of a cell from the field's solid: there the part stands in the open
_DULL = 0.2  # reflectance of an oxidised part
_SPREAD = 9, 7  # columns and rows of a projector's pixels that stand for all
_ALL_ROUND = 0.1  # of a border's jump: so much it may vary that is the same everywhere


@dataclass(frozen=True)
class LitLine(Displayed):
    """Where straight light draws the laser line: y (N,) of its rays and points (N, 3) on the part.

    In mm, the points in the world frame. Of a projector they are spread over its image, and y NaN.
    """

    y_mm: Array
    points_mm: Array

    @property
    def middle_mm(self) -> Array:
        """Where the laser's axis meets the part (3,): y = 0 of the line; NaN if none is lit."""
        lit = np.isfinite(self.points_mm).all(axis=1)
        if not lit.any():
            return np.full(3, np.nan)
        order = np.argsort(self.y_mm[lit])
        y, points = self.y_mm[lit][order], self.points_mm[lit][order]
        middle = [np.interp(0.0, y, each) for each in points.T]
        return np.round(middle, 6) + 0.0  # the rest is rounding


@dataclass(frozen=True, eq=False, repr=False)
class SeenSurface(Displayed):
    """What straight light does where a source lights points of the part.

    Attributes
    ----------
    interaction : mitsuba.SurfaceInteraction3f
        Of rays from the camera to the points.
    reached : ndarray of bool of shape (N,)
        Whether the camera sees the point.
    toward, light : ndarray of shape (N, 3)
        Unit vectors from the camera and from the source to the points.
    sent : ndarray of shape (N,)
        Value of the material's BSDF from the light to the camera, times the cosine of the light's
        incidence.
    """

    interaction: Any
    reached: NDArray[np.bool_]
    toward: Array
    light: Array
    sent: Array

    @staticmethod
    def of(scene: Scene, points_mm: Array, y_mm: Array) -> "SeenSurface":
        """At points (N, 3) in mm, world frame, that the source lights, at y (N,) of its line."""
        origin_mm, source = scene.camera.pose.origin_mm, scene.source
        toward = points_mm - origin_mm
        distance_mm = np.linalg.norm(toward, axis=1)
        toward /= distance_mm[:, None]
        if isinstance(source, Projector):
            light = points_mm - source.pose.origin_mm
            light /= np.linalg.norm(light, axis=1, keepdims=True)
        else:
            light = source.family.rays(0.0, y_mm)[1]
        start = mi.Point3f(to_vectors(np.broadcast_to(origin_mm, points_mm.shape)))
        si = scene.mitsuba.ray_intersect(mi.Ray3f(start, mi.Vector3f(to_vectors(toward))))
        reached = np.abs(np.array(si.t) - distance_mm) < _SAME_MM
        back = mi.Vector3f(to_vectors(-light))
        answer = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(back))
        sent = np.array(answer).reshape(-1, len(points_mm)).max(axis=0)
        return SeenSurface(si, reached, toward, light, sent)

    def _line(self) -> str:
        return f"{int(self.reached.sum())} of {self.reached.size} points seen"

    def shape(self, scene: Scene) -> Any:
        """The first of Mitsuba's shapes on which points are that the camera sees."""
        seen = self.interaction.shape
        shapes = scene.mitsuba.shapes()
        return next(s for s in shapes if np.any(np.array(seen == mi.ShapePtr(s))[self.reached]))


def check_scene(scene: Scene, facets: bool = True) -> list[str]:
    """Check geometry and field of a scene: each camera with each source.

    `facets`: note also what those of a mesh cost.

    Returns
    -------
    list of str
        What the user should know, though it can be measured: with at least one of the pairs, if
        there are any.

    Raises
    ------
    InputError
        Naming the file, the element and the remedy.
    """
    with naming(scene.path):
        for name in scene.cameras:
            _check_place(scene, scene.only(camera=name).camera_element, scene.cameras[name].pose)
        for name in scene.sources:
            _check_place(scene, scene.only(source=name).source_element, scene.sources[name].pose)
    pairs = [(camera, source) for camera in scene.cameras for source in scene.sources]
    notes: dict[str, list[str]] = {}
    refused: dict[str, InputError] = {}
    for camera, source in pairs:
        pair = f"{camera} with {source}"
        try:
            found = _check_pair(scene.only(camera, source), facets)
        except InputError as error:
            found, refused[pair] = [f"{error}"], error
        for note in found:
            notes.setdefault(note, []).append(pair)
    if pairs and len(refused) == len(pairs):
        raise next(iter(refused.values()))
    return [
        note if len(of) == len(pairs) else f"{', '.join(of)}: {note}" for note, of in notes.items()
    ]


def air_notes(scene: Scene) -> list[str]:
    """What `check_scene` tells of a scene with air, and what it would refuse it for."""
    if scene.medium is None:
        return []
    try:
        return check_scene(scene)
    except InputError as error:
        return [f"{error}"]


def _check_pair(scene: Scene, facets: bool) -> list[str]:
    """Check the one camera with the one source."""
    line = lit_line(scene)
    with naming(scene.path):
        _check_solid(scene, line)
        found = _check_border(scene, scene.medium, line) if scene.medium else []
        found += _facet_note(scene, line) if facets else []
    found += _shine_note(scene, line)
    return found + _focus_note(scene, line) + _glow_note(scene, line)


def _facet_note(scene: Scene, line: LitLine) -> list[str]:
    """Note how far the facets under the line are beside the curved surface that they stand for."""
    error_mm = 0.0
    for held in map(mi.traverse, scene.mitsuba.shapes()):
        if "faces" in held:
            vertices = np.array(held["vertex_positions"], float).reshape(-1, 3)
            faces = np.array(held["faces"], np.int64).reshape(-1, 3)
            error_mm = max(error_mm, facet_error_mm(vertices, faces, line.points_mm))
    pixel_mm = float(scene.camera.pixel_mm(line.points_mm).mean())
    if error_mm < FACETS_TOLD_PX * pixel_mm:
        return []
    tolerance_um = 1e3 * FACETS_TOLD_PX * pixel_mm
    return [
        f"{FACETS_LIE} up to {1e3 * error_mm:.2g} um ({error_mm / pixel_mm:.2g} px) beside"
        f" the curved surface, where the {_light(scene.source).split()[-1]} meets them (estimated"
        " from the angles between them);"
        f" export the part finer, with a chord tolerance of {tolerance_um:.1g} um"
    ]


def _shine_note(scene: Scene, line: LitLine) -> list[str]:
    """Note how much of a line a smooth metal mirrors past the camera."""
    shapes = scene.mitsuba.shapes()
    glossy = int(mi.BSDFFlags.Glossy)
    if not any(int(shape.bsdf().flags()) & glossy for shape in shapes if shape.bsdf()):
        return []
    shown = scene.camera.inside(scene.camera.project(line.points_mm))
    if not shown.any():
        return []
    seen = SeenSurface.of(scene, line.points_mm[shown], line.y_mm[shown])
    sent = seen.sent[seen.reached]
    if not np.any(sent > 0.0):  # a black frame, whose cause is told
        return []
    dark = np.mean(sent < FAINT * sent.max())
    if dark < _FAINT_TOLD:
        return []
    return [
        f'<bsdf id="{seen.shape(scene).bsdf().id()}">: where {dark:.0%} of the'
        f" {_light(scene.source)} falls, the smooth surface mirrors it past the camera: less than"
        f" {FAINT:g} of the light of the brightest point is left; give a rougher one (roughness),"
        " or turn the sensor (beta, tilt, alpha)"
    ]


def _focus_note(scene: Scene, line: LitLine) -> list[str]:
    """Note light that a camera with a lens has nowhere in focus."""
    camera = scene.camera
    if camera.lens is None:
        return []
    seen = camera.inside(camera.project(line.points_mm))
    blur_px = circle_of_confusion(camera.lens, camera, line.points_mm[seen]).max(axis=1)
    sharpest, most = np.min(blur_px, initial=np.inf), np.max(blur_px, initial=0.0)
    if not FOCUS_TOLD_PX < sharpest < np.inf:
        return []
    depth_mm = camera.pose.to_local(line.points_mm[seen])[:, 2]
    return [
        f"{scene.camera_element}: the {_light(scene.source)} is nowhere in focus: its blur is"
        f" {sharpest:.3g} to {most:.3g} px wide; it lies {depth_mm.min():.4g} to"
        f" {depth_mm.max():.4g} mm before the lens, which is focused at"
        f" {camera.lens.focus_distance_mm:.6g} mm (focus_distance; a larger f_number blurs less)"
    ]


def _glow_note(scene: Scene, line: LitLine) -> list[str]:
    """Note how bright a glowing part is beside the line."""
    glow = arrangement(scene).glow
    if not glow:
        return []
    source = scene.source
    if isinstance(source, Projector):
        source = source.with_pattern(Uniform())
    share = glow / (irradiance(source, line.points_mm).max() * _DULL / np.pi)
    return [
        f"the hot part glows with {glow:.2g} W/(mm^2 sr) through its filter: {_roughly(share)} of"
        f" the {_light(source)} on a surface that reflects {_DULL:.0%}"
    ]


def _roughly(number: float) -> str:
    """A positive number's first digit, written out."""
    return f"{float(f'{number:.1g}'):g}"


def _kind(source: LaserLine | Projector) -> str:
    return "projector" if isinstance(source, Projector) else "laser"


def _light(source: LaserLine | Projector) -> str:
    return "projector's light" if isinstance(source, Projector) else "laser line"


def lit_line(scene: Scene) -> LitLine:
    """Find a source's light on the part by straight light, and check all but the field's border.

    Raises
    ------
    InputError
        If the sensor can't measure, the camera or the laser stands where it can't, no point of the
        line is in the picture, or the field does not hold all of it.
    """
    with naming(scene.path):
        camera, source = scene.camera, scene.source
        if isinstance(source, Projector):
            _check_baseline(camera, source)
        else:
            check_geometry(scene.sensor)
        _check_place(scene, scene.camera_element, camera.pose)
        _check_place(scene, scene.source_element, source.pose)
        line = _line_on_part(scene)
        if scene.medium:
            _check_cover(scene, scene.medium, line)
    return line


def _check_baseline(camera: Pinhole, projector: Projector) -> None:
    """The camera must see the projector's light from the side."""
    middle = projector.rays_of(*(np.array(projector.size) / 2.0 - 0.5))
    start, along = projector.family.rays(*middle)
    offset = camera.pose.origin_mm - start
    base = float(np.linalg.norm(offset - (offset @ along) * along))
    distance = max(float(np.linalg.norm(camera.pose.origin_mm - projector.target_mm)), NEAREST_MM)
    if not base > SINGULAR * distance:
        raise InputError(
            f"sensor: the camera's projection centre lies {base:.3g} mm from the projector's axis,"
            " so that no depth can be measured; turn the camera away from it, to alpha = 60 deg for"
            " example"
        )


def _check_place(scene: Scene, element: str, pose: Pose) -> None:
    """A camera or a source must not stand inside the part or below the field's floor."""
    x, y, z = pose.origin_mm
    place = f"{element} at ({x:.1f}, {y:.1f}, {z:.1f}) mm"
    forward = to_vectors(pose.rotation[:, 2][None])
    if np.any(np.array(scene.surface.starts_inside(to_vectors(pose.origin_mm[None]), forward))):
        raise InputError(f"{place} is inside the part; move it out (to_world)")
    if scene.medium and scene.medium.to_local(pose.origin_mm)[2] < scene.medium.box[0, 2]:
        floor = scene.medium.box[0, 2]
        raise InputError(
            f"{place} is under the floor of the air's field, z = {floor:g} mm; turn the sensor"
            " less (beta, tilt, alpha)"
        )


def _line_on_part(scene: Scene) -> LitLine:
    """Trace the source's rays to the part; some of the points must be in the picture."""
    source = scene.source
    kind, light = _kind(source), _light(source)
    asked: Any
    if isinstance(source, Projector):
        sides = (
            np.linspace(0.0, n - 1.0, count) for n, count in zip(source.size, _SPREAD, strict=True)
        )
        pixel = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
        y, asked = np.full(len(pixel), np.nan), {"projector_pixel": pixel}
    else:
        y = source.along(33)
        asked = {"laser_y_mm": y}
    found = ray_search(scene.cold(), **asked, k_stop=1, method="paper", r_max_um=np.inf)
    met = found.status != SearchStatus.LASER_MISSED
    if not met.any():
        box = scene.mitsuba.bbox()
        raise InputError(
            f"{scene.source_element}: the {kind} misses the part; turn it (to_world, tilt) or move"
            f" the part, which lies from {_point(box.min)} to {_point(box.max)} mm"
        )
    outside, hidden = (
        found.status[met] == reason
        for reason in (SearchStatus.OUTSIDE_IMAGE, SearchStatus.UNDERCUT)
    )
    if np.all(outside | hidden):
        raise InputError(
            f"{scene.camera_element}: "
            + (
                f"the part hides the {light} from the camera; turn the camera (to_world, alpha)"
                if hidden.any()
                else f"the camera's image does not hold the {light}; turn the camera (to_world,"
                " alpha) or widen its fov"
            )
        )
    return LitLine(y[met], found.laser_point_mm[met])


def _check_cover(scene: Scene, field: IndexField, line: LitLine) -> None:
    """The field must hold the lit part of the surface."""
    low, high = field.box
    points = field.to_local(line.points_mm)
    short = np.maximum(low - points, points - high)
    if not np.any(short > 0.0):
        return
    axis = int(np.argmax(short.max(axis=0)))
    frame = " in the moved field's own frame" if field.pose else ""
    remedy = wrong_scale(scene.mitsuba, field) or (
        f"give a larger field, make one of this part ({scene.simulate_command}), or move it"
        " (to_world of the integrator)"
    )
    where = _point(points[np.argmax(short.max(axis=1))])
    raise InputError(
        f"{_air(scene)} from {_point(low)} to {_point(high)} mm does not cover the light path: the"
        f" {_kind(scene.source)} meets the part at {where} mm{frame},"
        f" {short[:, axis].max():.3g} mm beyond its end along {'xyz'[axis]}; {remedy}"
    )


def _check_solid(scene: Scene, line: LitLine) -> None:
    """The field's solid must have much in common with the part; that it is the part, notes tell."""
    fit, field = scene.field_fit, scene.medium
    if fit is None or field is None:
        return
    height = fit.solid.height_mm(field.to_local(line.points_mm))
    if fit.outside > REFUSED or np.median(height) > _CELLS_FAR * fit.solid.cell_mm:
        middle = np.median(height)
        lit = "laser's line" if isinstance(scene.source, LaserLine) else "lit surface"
        off = f"; the {lit} lies {middle:.2g} mm above it" if middle > 0.0 else ""
        raise InputError(
            f"{_air(scene)} is not of this part: {fit.words}{off}; make one of this part"
            f" ({scene.simulate_command}), or give none (field=)"
        )


def _air(scene: Scene) -> str:
    """A scene's air, for messages: with its element, if it is the scene's own."""
    own = '<integrator type="refractive">: ' if scene.air.path else ""
    return own + scene.air_name


def _check_border(scene: Scene, field: IndexField, line: LitLine) -> list[str]:
    """The field must fade where light enters it."""
    notes, border = [], border_of(field.nodes, field.mirror)
    remedy = "give a field that reaches further out"
    if np.ptp(border) <= _ALL_ROUND * abs(np.median(border) - field.ambient):
        remedy = (
            f"its border is {np.median(border):.3g} all round, its ambient {field.ambient:.3g}: was"
            " the ambient forgotten?"
        )
    for name, crossing in border_crossings(field, scene.camera, scene.source, line).items():
        worst = int(np.argmax(crossing.shift_px))
        text = (
            f"{_air(scene)} does not fade to ambient where the {name}'s light enters it, at"
            f" {_point(crossing.place_mm[worst])} mm: a jump of {crossing.jump[worst]:.1e} in"
            f" n - 1, which moves the image by about {crossing.shift_px[worst]:.2g} px"
        )
        if crossing.shift_px[worst] > JUMP_REFUSED_PX:
            raise InputError(f"{text}; {remedy}")
        if crossing.shift_px[worst] > JUMP_TOLD_PX:
            notes.append(text)
    return notes


def border_crossings(
    field: IndexField, camera: Pinhole, source: LaserLine | Projector, line: LitLine
) -> dict[str, BorderCrossing]:
    """Where the camera's and the source's light enters a field on its straight path to the part.

    Returns
    -------
    dict
        `BorderCrossing` by "camera" and "laser" or "projector", one row per point of the line.
    """
    families = {"camera": camera, _kind(source): source.family}
    return {
        name: border_crossing(field, camera, family, line.points_mm)
        for name, family in families.items()
    }


def _point(xyz: Array | tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{float(v):.4g}" for v in xyz) + ")"
