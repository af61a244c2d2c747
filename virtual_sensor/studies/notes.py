"""What a reader of a study's figures should know: parts left out, and what is too coarse."""

import json
import shlex
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.imaging.render import RenderReport
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.netcdf import read_field_file
from virtual_sensor.medium.netcdf_elements import open_netcdf
from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.metrology.truth import (
    FINE_PX,
    WRONG_PX,
    WRONG_SIGMAS,
    DotErrors,
    LineErrors,
)
from virtual_sensor.optics.ray_search import FoundPixels, ray_search
from virtual_sensor.records import counts_in_words, counts_of
from virtual_sensor.studies.error_split import ErrorSplit
from virtual_sensor.studies.field_grid import COARSE_PX, furthest, pixel_loss
from virtual_sensor.studies.probes import probe_rays

Array = NDArray[np.float64]

BESIDE_MM = 1.0
"""Of a line from the solid of its field: a fifth of the layer of hot air on a hot part."""

_MANY = 0.1  # of what is expected: that so much is missing or wrong is a caveat
_CLOSER = 2.0 / 3.0  # of the nodes' distance: half a minute's work
_APART_PX = 2.0  # images of the line as seen from points of a pupil: wider lines run into one
_HARDLY = 0.25  # of the centres: that no more are compared is one
_FINER = "; a finer film (width, height) or a wider line (line_radius) has more"


def unlit_rays(laser: LaserLine, y_mm: Array) -> list[str]:
    """Note of the probe rays that the laser does not light."""
    unlit = y_mm[~laser.reaches(0.0, y_mm)]
    if not unlit.size:
        return []
    what = (
        "dots are at other places" if laser.dots_mm.size else f"line is {laser.length_mm:g} mm long"
    )
    places = ", ".join(f"{y:g}" for y in unlit)
    return [
        f"laser_line: {unlit.size} of {y_mm.size} probe rays are not lit, at y = {places} mm: the"
        f" {what}; these have no figures"
    ]


def beside_solid(scene: Scene, points_mm: Array) -> list[str]:
    """Note of a line, lit at points (N, 3), that does not lie on the solid of the scene's field."""
    fit, field = scene.field_fit, scene.field
    points_mm = points_mm[np.isfinite(points_mm).all(axis=1)]
    if fit is None or field is None or not len(points_mm):
        return []
    height = fit.solid.height_mm(field.to_local(points_mm))
    middle = float(np.median(height))
    if abs(middle) <= BESIDE_MM:
        return []
    where = "above" if middle > 0.0 else "inside"
    return [
        f"the laser's line lies {abs(middle):.2g} mm {where} the solid of"
        f" {fit.name}: what the air does to this line is not known"
    ]


def coarse_grid(scene: Scene) -> dict[str, bool]:
    """Note of a field whose grid loses more than is seen; some 0.15 s for a field of 2 MB.

    Returns
    -------
    dict from str to bool
        With the note, if there is one, whether it is a caveat: that a tenth of what the air does to
        the line is lost, and a measurement would show it.
    """
    field = scene.field
    if field is None:
        return {}
    y = probe_rays(scene)
    file = scene.air.path
    solid = read_field_file(file, scene.air.wavelength_nm).solid if file else None
    if solid is not None and solid.shape != field.shape:
        solid = None

    def pixels(other: IndexField | None) -> Array:
        return ray_search(scene.with_medium(other), y, "newton").pixel

    hot = pixels(field)
    along = np.zeros(2) if scene.sensor.laser.dots_mm.size else _tangents(hot)

    def places(other: IndexField | None) -> Array:  # a shift along the line is none of the line
        shift = (hot if other is field else pixels(other)) - hot
        return shift - np.sum(shift * along, axis=1, keepdims=True) * along

    loss = pixel_loss(field, solid, places)
    name = file.name if file else "the field"
    if np.isnan(loss.every_2nd):
        return {f"{name}: its grid has too few nodes to estimate its error": False}
    if loss.present <= FINE_PX:
        return {}
    beside = hot + np.array([0.0, loss.present])
    error_um = 1e3 * furthest(triangulate(scene.sensor, beside) - triangulate(scene.sensor, hot))
    moved_px = furthest(places(None))
    lost_px, lost_um, air_px = map(_two_digits, (loss.present, error_um, moved_px))
    note = (
        f"{name}: its grid is not fine enough: it loses about {lost_px} px of the line's place"
        f" ({lost_um} um), where the air moves it by {air_px} px across itself;"
        f" {_closer_nodes(file, field)}"
    )
    return {note: loss.present > max(COARSE_PX, _MANY * moved_px)}


def _two_digits(number: float) -> str:
    return np.format_float_positional(number, 2, fractional=False, trim="-")


def _closer_nodes(file: Path | None, field: IndexField) -> str:
    """How to make a finer field: a command, if its simulation lies beside it."""
    remedy = "make it with closer nodes (field simulate --grid, field import --spacing)"
    if file is None or not (case := file.with_suffix(".case")).is_dir():
        return remedy
    attributes = open_netcdf(file).attributes
    try:
        command = shlex.split(f"{attributes['history']}")[1:]  # behind the date
        cell_mm = float(json.loads(f"{attributes['parameters']}")["cell_mm"])
    except (ValueError, TypeError, KeyError):
        return remedy
    if command[:3] != ["virtual-sensor", "field", "simulate"]:
        return remedy
    kept = without_options(command, "-o", "--output", "--case", "--grid")
    here = Path.cwd()
    folder = file.parent.relative_to(here) if file.is_relative_to(here) else file.parent
    if cell_mm > field.spacing.max():
        finer = [*without_options(kept, "--cell"), "--cell", _two_digits(_CLOSER * cell_mm)]
        finer += ["-o", f"{folder / 'finer_cells.nc'}"]
        return (
            f"closer nodes don't help, since the flow's cells, {cell_mm:g} mm, are wider; finer"
            f" cells: `{shlex.join(finer)}`"
        )
    kept += ["--grid", ",".join(map(_two_digits, _CLOSER * field.spacing))]
    kept += ["--case", f"{folder / case.name}", "-o", f"{folder / 'closer_nodes.nc'}"]
    return f"closer nodes, without solving the flow again: `{shlex.join(kept)}`"


def without_options(command: list[str], *options: str) -> list[str]:
    """A command's words without some options and their values."""
    kept, words = [], iter(command)
    for word in words:
        if word in options:
            next(words, None)
        elif word.partition("=")[0] not in (*options, "--overwrite"):
            kept.append(word)
    return kept


def _tangents(pixel: Array) -> Array:
    """Unit vectors (N, 2) along a line through pixels (N, 2) of an image, from one to the next."""
    if len(pixel) < 2:
        return np.zeros_like(pixel)
    steps = np.gradient(pixel, axis=0)
    return np.nan_to_num(steps / np.linalg.norm(steps, axis=1, keepdims=True))


def upright_line(found: FoundPixels, camera: str) -> list[str]:
    """Note of a searched line that stands upright in the image of the camera of this element."""
    steps = np.abs(np.diff(found.pixel, axis=0))
    steps = steps[np.isfinite(steps[:, 0])]
    if not len(steps) or np.median(steps[:, 1]) <= np.median(steps[:, 0]):
        return []
    return [
        f"{camera}: the laser line stands upright in the image, where its centres are searched for"
        " column by column; turn the camera by 90 degrees about its axis (to_world)"
    ]


def frame_notes(report: RenderReport) -> list[str]:
    """Notes of a frame: what was made otherwise than asked, or too coarsely."""
    notes = []
    if report.reason:
        notes.append(
            f"the frame was {report.transport}: {report.reason}"
            + f"; {report.folded_pixels} pixels of folded light are black"
            * bool(report.folded_pixels)
        )
    if report.march_px > FINE_PX:
        notes.append(
            f"steps of the march are too long: half as long, they move the light by up to"
            f" {report.march_px:.2g} px; give shorter ones (step)"
        )
    if report.pupil_gap_px > _APART_PX:
        notes.append(
            f"the lens's blur is drawn by {report.pupil_points} points of its pupil, whose images"
            f" lie up to {report.pupil_gap_px:.2g} px apart: a line narrower than that shows as"
            " several; give more (sub_pupils)"
        )
    return notes


def unsplit(split: ErrorSplit) -> list[str]:
    """Note of a recorded line of none of whose points it is known what the error is made of."""
    if split.known.any() or not np.isfinite(split.error_um).any():
        return []
    return [
        "what the error is made of is not known of any point: where the recorded frame has a"
        " centre, the ideal frame or the search has none, as of a line that is too narrow"
        " (line_radius, width, height)"
    ]


def centre_notes(
    line: LineCentres,
    compared: LineErrors | DotErrors,
    by_frame: LineErrors,
    gap_y_mm: tuple[float, float],
    speckled: bool = False,
) -> dict[str, bool]:
    """Notes of centres that are in no figure, or wrong; and whether figures without are worth much.

    Parameters
    ----------
    line : LineCentres
    compared : LineErrors or DotErrors
        Beside the ray search.
    by_frame : LineErrors
        Beside the frame's own truth.
    gap_y_mm : pair of float
        Ends of the longest stretch of the line on which no point is measured.
    speckled : bool
        Whether its light is: the centres' sigmas know the noise, and not the grains.

    Returns
    -------
    dict from str to bool
        For each note, whether it is a caveat: so many are missing or wrong that the rest says
        little.
    """
    if isinstance(compared, DotErrors):
        dots = len(compared.pixel)
        few = 0 < compared.count < (1.0 - _MANY) * dots
        return {f"{compared.count} of {dots} dots were found": few} if compared.count < dots else {}
    counts = counts_of(line.status, Status)
    centres = int(line.found.sum())
    if not centres:
        # Beside a line that lies in some columns alone, those without are no news.
        main = max(counts, key=lambda name: counts[name] * (_MANY if name == "no_peak" else 1.0))
        why = Status[main.upper()].message.removesuffix(".")
        why = why[0].lower() + why[1:]
        reasons = ", ".join(name for name, number in counts.items() if number)  # as cold, so hot
        return {f"no line centres, the columns are {reasons}; {why}": False}
    notes = {}
    lost = counts_of(compared.lost, Status)
    if compared.lost.size:
        few = compared.lost.size > _MANY * compared.expected
        start, end = gap_y_mm
        where = f", and none has one from y = {start:.1f} to {end:.1f} mm" * few
        narrow = few and 2 * lost["too_narrow"] > compared.lost.size
        notes[
            f"{compared.lost.size} of {compared.expected} columns that see the whole line have no"
            f" centre: {counts_in_words(lost)}{where}{_FINER * narrow}"
        ] = few
    cut, stray = compared.cut_centres, compared.stray_centres
    left_out = {
        f"{cut} {'is' if cut == 1 else 'are'} cut by an edge": cut,
        f"{stray} {'lies' if stray == 1 else 'lie'} off the searched line": stray,
    }
    if any(left_out.values()):
        reasons = ", ".join(words for words, number in left_out.items() if number)
        notes[f"{compared.count} of {centres} centres were compared with the search; {reasons}"] = (
            compared.count < _HARDLY * centres
        )
    if wrong := int(by_frame.wrong().sum()):
        far, are = (
            f"{WRONG_PX:g} px or " * bool(by_frame.largest_px > WRONG_PX),
            "are" if wrong > 1 else "is",
        )
        notes[
            f"{wrong} of {by_frame.count} centres {are} off the frame's"
            f" truth by more than {far}{WRONG_SIGMAS:g} of their sigmas, at most by"
            f" {by_frame.largest_px:.2g} px"
            + ", since their sigmas know nothing of speckle"
            * speckled
        ] = wrong > _MANY * by_frame.count
    return notes
