"""A whole surface that fringes measured, before and after the correction, pixel by pixel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed, listed
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.fringes.decoded import DecodedFringes
from virtual_sensor.metrology.range_image import RangeImage, reconstruct
from virtual_sensor.metrology.truth import largest, mean, rms
from virtual_sensor.records import Record
from virtual_sensor.studies.correct.scene_part import ScenePart

Image = NDArray[np.float32]


@dataclass(frozen=True)
class SurfaceErrors(Record):
    """How far all points of a surface are from the scene's part, before and after.

    Attributes
    ----------
    pixels : int
        With a corrected point.
    rms_um, mean_um, largest_um : float
        Of the corrected points' signed distances, positive outside; the largest in magnitude.
    uncorrected_rms_um : float
        Of the uncorrected points.
    epipolar_px : float or None
        Residual across the epipolar lines of straight light, rms, in px of the camera; None where
        one axis was decoded.
    """

    pixels: int
    rms_um: float
    mean_um: float
    largest_um: float
    uncorrected_rms_um: float
    epipolar_px: float | None


@dataclass(frozen=True)
class CorrectedSurface(Displayed):
    """A surface before and after, H x W pixels of the camera.

    Attributes
    ----------
    uncorrected : RangeImage
        As if light ran straight.
    corrected : RangeImage
        Through the air.
    uncorrected_um, corrected_um : ndarray of shape (H, W)
        Signed distances from the scene's part; NaN where there is none.
    """

    uncorrected: RangeImage
    corrected: RangeImage
    uncorrected_um: Image
    corrected_um: Image

    @staticmethod
    def of(scene: Scene, fringes: DecodedFringes) -> CorrectedSurface:
        """By the scene's air, or straight twice where it has none."""
        shape = ScenePart.of(scene).shape
        straight = reconstruct(scene, fringes)
        bent = straight
        if scene.medium is not None:
            bent = reconstruct(scene, fringes, medium=scene.medium)
        before = straight.deviation_um(shape)
        after = before if bent is straight else bent.deviation_um(shape)
        return CorrectedSurface(straight, bent, before, after)

    def _line(self) -> str:
        errors = self.errors
        before = f"uncorrected {errors.uncorrected_rms_um:.3g} µm rms"
        return listed(f"{errors.pixels} pixels", before, f"corrected {errors.rms_um:.3g} µm")

    @cached_property
    def errors(self) -> SurfaceErrors:
        """The figures."""
        residual: Any = self.uncorrected.epipolar_px
        before, known = (
            each[np.isfinite(each)].astype(float)
            for each in (self.uncorrected_um, self.corrected_um)
        )
        return SurfaceErrors(
            int(self.corrected.ok.sum()),
            rms(known),
            mean(known),
            largest(known),
            rms(before),
            None if residual is None else rms(residual),
        )
