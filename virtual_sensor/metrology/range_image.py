"""Range images: a point for each pixel of a camera, from a projector's decoded pixels.

A camera's pixel and the column of the projector that it sees give a point by triangulation; the
row, where it was decoded too, takes part by least squares, or shows by its residual what the air
has done (`optics.epipolar`).  Light runs straight, or through a medium.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import number_within, one_of, shares
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, span, tally
from virtual_sensor.errors import InputError, short
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.metrology.range_mesh import STEEPEST_DEG, RangeMesh, mesh_of
from virtual_sensor.metrology.shapes import Shape
from virtual_sensor.optics.crossing_status import CrossingStatus
from virtual_sensor.optics.ray_families import Pinhole, PixelFamily

Array = NDArray[np.float64]
Image = NDArray[np.float64]

USES = ("column", "row", "both")
"""Which of the projector's coordinates give the points."""
FAR_BETTER = 3.0
"""Times as much as the column must the row tell of the depth to be used in its place."""

_SAMPLE = 400  # pixels of which a sensor's geometry is seen


@public
@dataclass(frozen=True)
class RangeImage(Displayed):
    """The points that a camera's pixels see; NaN where `status` is not OK.

    Attributes
    ----------
    point_mm : ndarray of shape (H, W, 3)
        World.
    depth_mm : ndarray of shape (H, W)
        Along the camera's axis.
    sigma_um : ndarray of shape (H, W)
        Standard deviation of the point along its line of sight, from that of the decoded pixel;
        NaN where that is not known.
    epipolar_px : ndarray of shape (H, W) or None
        Distance of the camera's pixel from the straight epipolar line of its projector pixel, as
        `epipolar_residual` has it; None unless both axes were decoded.
    status : ndarray of uint8 of shape (H, W)
        `CrossingStatus`.
    projector_pixel : ndarray of shape (H, W, 2)
        (u, v) of the projector's ray that lights the point: of the axis used, the decoded one; of
        the other, what it should have been.  Where that differs from what was decoded, light took
        another path than was computed: the air is another.
    """

    _field_units: ClassVar = {"projector_pixel": "px"}
    _statuses: ClassVar = {"status": CrossingStatus}
    _by_row: ClassVar = True

    point_mm: Image
    depth_mm: Image
    sigma_um: NDArray[np.float32]
    epipolar_px: NDArray[np.float32] | None
    status: NDArray[np.uint8]
    projector_pixel: Image

    def _line(self) -> str:
        return listed(
            tally(self.status, CrossingStatus.OK),
            span("depth", self.depth_mm, "mm"),
            span("sigma", self.sigma_um, "µm"),
        )

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Mask (H, W) of the pixels that have a point."""
        return self.status == CrossingStatus.OK

    def deviation_um(self, shape: Shape) -> NDArray[np.float32]:
        """How far the points are from a shape along its normal, (H, W), um: positive outside.

        Parameters
        ----------
        shape : Shape
            The true surface: of a scene `PartShape.of(scene)`; or `CylinderShape`, `PlaneShape`,
            `SphereShape`.  NaN where it is nowhere near.
        """
        if not isinstance(shape, Shape):
            raise InputError(
                f"deviation_um: shape is {short(shape)}; give a Shape, such as PartShape.of(scene)"
            )
        deviation = np.full(self.status.shape, np.nan, np.float32)
        index = np.flatnonzero(self.ok)
        points = self.point_mm.reshape(-1, 3)
        for some in shares(len(index)):
            at = index[some]
            deviation.ravel()[at] = UM_PER_MM * shape.distance(points[at]).distance_mm
        return deviation

    def mesh(self, steepest_deg: float = STEEPEST_DEG) -> RangeMesh:
        """The points as triangles; none bridges an edge, where depth jumps.

        Parameters
        ----------
        steepest_deg : float
            How far the steepest triangle that is kept leans from the camera's view.
        """
        return mesh_of(self, steepest_deg)


@public
def reconstruct(
    sensor: Any,
    decoded: Any,
    *,
    medium: Any = None,
    use: str | None = None,
    camera: str | None = None,
    source: str | None = None,
    tolerance_px: float = 1e-3,
) -> RangeImage:
    """Make a range image of decoded fringes: straight, or through a medium.

    Parameters
    ----------
    sensor : Scene, FringeCalibration, str or Path
        What has a camera and a projector: a scene, its name or path; or a calibration, or the path
        of its file, .yaml or .json.
    decoded : DecodedFringes
        Of an image of the camera's size: the projector's `column` and `row`, with their sigmas.
    medium : IndexField, str or Path, optional
        That bends both lines of sight and the projector's light: the scene's, say
        (`scene.medium`), or the file of another.  By default light runs straight.
    use : str, optional
        "column": the points come from the decoded column alone; "row": from the row; "both": from
        both by least squares, weighted by their sigmas.  By default the column; the row where it
        tells the depth far better, as of a projector that stands above the camera rather than
        beside it, or where it alone was decoded.
    camera, source : str, optional
        Names, where the scene has several.
    tolerance_px : float
        Of the maps of bent rays that are made, and kept for the next call.

    Returns
    -------
    RangeImage

    Raises
    ------
    InputError
        Where the image has not the camera's size, or an axis that is to be used was not decoded.
    """
    number_within("reconstruct: tolerance_px", tolerance_px, 1e-9, 1e3, "a positive number of px")
    view, light, medium = _devices(sensor, medium, camera, source)
    column, row = (_coordinate(decoded, name, view) for name in ("column", "row"))
    if use is None:
        use = "row" if column is None or _rows_tell_depth(view, light, decoded) else "column"
    one_of("reconstruct: use", use, USES)
    used = {"column": column is not None, "row": row is not None}
    for axis, there in used.items():
        if use in (axis, "both") and not there:
            raise InputError(
                f"reconstruct: use is '{use}', and no {axis} was decoded; project patterns along"
                f" {'u' if axis == 'column' else 'v'} too, or use the other axis"
            )
    return _image(view, light, decoded, use, medium, tolerance_px)


def depth_in_axes(
    camera: Pinhole, projector: PixelFamily, pixel: Array, projector_pixel: Array
) -> Array:
    """How much the projector's column and row tell of the depth: px per mm, medians, shape (2,).

    Parameters
    ----------
    camera : Pinhole
    projector : PixelFamily
    pixel, projector_pixel : ndarray of shape (N, 2)
        Of the camera, and of the projector that they see; NaN are left out, and a sample is enough.
    """
    from virtual_sensor.optics.epipolar import coordinates_of
    from virtual_sensor.optics.sight_points import sight_points

    known = np.flatnonzero(np.isfinite(projector_pixel).all(axis=1))
    some = known[:: max(1, known.size // _SAMPLE)]
    sight, lit = coordinates_of(camera, pixel[some]), projector_pixel[some]
    found = sight_points(None, camera, projector, sight, lit, np.ones_like(lit), 1.0)
    px_per_mm = np.abs(found.px_per_mm[found.status == CrossingStatus.OK])
    return np.median(px_per_mm, axis=0) if len(px_per_mm) else np.full(2, np.nan)


def _rows_tell_depth(camera: Pinhole, projector: PixelFamily, decoded: Any) -> bool:
    """Whether rows were decoded, and tell the depth far better than columns."""
    if decoded.row is None:
        return False
    known = np.flatnonzero(np.isfinite(decoded.column) & np.isfinite(decoded.row))
    some = known[:: max(1, known.size // _SAMPLE)]
    v, u = np.divmod(some, decoded.row.shape[1])
    lit = np.column_stack([decoded.column[v, u], decoded.row[v, u]])
    by_column, by_row = depth_in_axes(camera, projector, np.column_stack([u, v]).astype(float), lit)
    return bool(by_row > FAR_BETTER * by_column)


def check_columns(
    task: str, camera: Pinhole, projector: PixelFamily, pixel: Array, projector_pixel: Array
) -> None:
    """Check that the projector's columns tell the depth, where a task finds points by them alone.

    Raises
    ------
    InputError
        If its rows tell it far better: `pixel` and `projector_pixel` as of `depth_in_axes`.
    """
    by_column, by_row = depth_in_axes(camera, projector, pixel, projector_pixel)
    if by_row > FAR_BETTER * by_column:
        raise InputError(
            f"{task}: the projector's rows tell the depth, {by_row:.2g} px/mm along a line of"
            f" sight, its columns {by_column:.2g}, and points are found by columns here; turn the"
            " projector by 90 degrees (to_world)"
        )


def _devices(
    sensor: Any, medium: Any, camera: str | None, source: str | None
) -> tuple[Pinhole, PixelFamily, Any]:
    """Camera, projector's rays and medium of a scene or a calibration."""
    if isinstance(sensor, str | Path) and Path(sensor).suffix.lower() in (".yaml", ".yml", ".json"):
        from virtual_sensor.metrology.fringes.calibration import FringeCalibration

        sensor = FringeCalibration.read(sensor)
    elif isinstance(sensor, str | Path):
        from virtual_sensor.optics.sight import scene_of

        sensor = scene_of("reconstruct", sensor)
    if hasattr(sensor, "cameras"):
        if isinstance(medium, str | Path):
            medium = sensor.with_medium(medium).medium
        sensor = sensor.only(camera, sensor.projector_name if source is None else source)
    view, projector = (getattr(sensor, name, None) for name in ("camera", "projector"))
    light = getattr(projector, "family", projector)
    if not (isinstance(view, Pinhole) and isinstance(light, PixelFamily)):
        raise InputError(
            f"reconstruct: sensor is {short(sensor)}; give a scene with a projector, its name or"
            " path, or a calibration of camera and projector"
        )
    if light.fisheye:
        raise InputError("reconstruct: sensor: a projector with a fisheye lens is not known here")
    if medium is not None and not hasattr(medium, "lookup"):
        raise InputError(
            f"reconstruct: medium is {short(medium)}; give an IndexField, such as scene.medium"
        )
    return view, light, medium


def _coordinate(decoded: Any, name: str, camera: Pinhole) -> Image | None:
    """A decoded coordinate, (H, W), checked."""
    if not (hasattr(decoded, "column") and hasattr(decoded, "row")):
        raise InputError(
            f"reconstruct: decoded is {short(decoded)}; give DecodedFringes, such as those of"
            " PhaseShift.decode"
        )
    if not getattr(decoded, "absolute", True):
        raise InputError(
            "reconstruct: decoded knows the projector's pixels but for whole periods, which give no"
            " points; project a second period, or Gray code"
        )
    values: Image | None = getattr(decoded, name)
    if values is None:
        return None
    width, height = camera.size
    if values.shape != (height, width):
        size = " x ".join(map(str, values.shape[::-1]))
        raise InputError(
            f"reconstruct: decoded is of images of {size} px, the camera has {width} x {height} px;"
            f" give images of that camera, or load the scene with width={values.shape[-1]}"
            f" height={values.shape[0]}"
        )
    return values


def _image(
    camera: Pinhole,
    projector: PixelFamily,
    decoded: Any,
    use: str,
    medium: Any,
    tolerance_px: float,
) -> RangeImage:
    from virtual_sensor.optics.epipolar import across_lines, coordinates_of
    from virtual_sensor.optics.sight_points import sight_points

    width, height = camera.size
    known = np.ones((height, width), bool)
    axes = {"column": ("column",), "row": ("row",), "both": ("column", "row")}[use]
    for axis in axes:
        known &= np.isfinite(getattr(decoded, axis))
    index = np.flatnonzero(known)
    row, column = np.divmod(index, width)
    sight = coordinates_of(camera, np.stack([column, row], axis=1).astype(float))
    pixel, sigma = (_pairs(decoded, names, index) for names in (_VALUES, _SIGMAS))
    weight = np.stack([np.full(len(index), float(axis in axes)) for axis in _VALUES], axis=1)
    if use == "both":
        both = (np.isfinite(sigma) & (sigma > 0.0)).all(axis=1)
        weight[both] = sigma[both] ** -2.0
    found = sight_points(medium, camera, projector, sight, pixel, weight, tolerance_px)

    with np.errstate(divide="ignore", invalid="ignore"):  # of pixels without noise
        information = np.where(weight > 0.0, (found.px_per_mm / sigma) ** 2, 0.0).sum(axis=1)
        sigma_um = UM_PER_MM / np.sqrt(information)
    residual = None
    if decoded.column is not None and decoded.row is not None:
        residual = across_lines(camera, projector, sight, coordinates_of(projector, pixel))
        residual[found.status != CrossingStatus.OK] = np.nan

    def image(values: NDArray[Any] | None, kind: Any = np.float64) -> Any:
        if values is None:
            return None
        whole = np.full((height * width, *values.shape[1:]), np.nan, kind)
        whole[index] = values
        return whole.reshape(height, width, *values.shape[1:])

    status = np.full((height, width), CrossingStatus.NO_PIXEL, np.uint8)
    status.ravel()[index] = found.status
    return RangeImage(
        image(found.point_mm),
        image(found.depth_mm),
        image(sigma_um, np.float32),
        image(residual, np.float32),
        status,
        image(found.projector_pixel),
    )


_VALUES, _SIGMAS = ("column", "row"), ("sigma_column", "sigma_row")


def _pairs(decoded: Any, names: tuple[str, str], index: NDArray[np.intp]) -> Array:
    """Two images' values at pixels, (N, 2); NaN of an image that there is not."""
    pairs = np.full((len(index), 2), np.nan)
    for column, name in enumerate(names):
        values = getattr(decoded, name, None)
        if values is not None:
            pairs[:, column] = values.ravel()[index]
    return pairs
