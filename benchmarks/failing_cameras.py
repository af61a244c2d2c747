"""Where cameras fail: too few sub-pupils, speckle, wrong exposures, lenses and calibrations.

The cold cylinder in a film of 256 x 256 pixels, recorded by cmos_5um5 where it is recorded.  A
centre with the status OK is wrong where it is farther from the truth than three of its own standard
errors and 0.05 px.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from worsening import Case, Outcome, judged

from virtual_sensor.errors import InputError
from virtual_sensor.files import scratch_folder
from virtual_sensor.imaging.exposures import render_exposure
from virtual_sensor.imaging.recording import record
from virtual_sensor.imaging.render import Frame, render_frame
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.imaging.speckle import Aperture
from virtual_sensor.metrology.calibration import calibration_of
from virtual_sensor.metrology.centres import FOUND, LineCentres
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.truth import TrueLine
from virtual_sensor.studies.notes import frame_notes

Array = NDArray[np.float64]

SCENE = "cold_cylinder"
FILM_PX = 256
WRONG_PX, SIGMAS = 0.05, 3.0
SENSOR = "cmos_5um5"

_MANY = 144  # sub-pupils
_ENDS_PX = 3.0


def cases() -> Iterator[Case]:
    """All of them."""
    here = f"{FILM_PX} x {FILM_PX} px, {SENSOR}"
    wrong = f"wrong is a centre off by more than {WRONG_PX:g} px and three of its standard errors"
    for count in (4, 16, 64):
        yield Case(
            "out of focus",
            f"{count} sub-pupils",
            (2.5, 5.0, 10.0, 20.0, 40.0),
            "mm that the plane in focus is behind the part",
            partial(_out_of_focus, count),
            f"f/4, without noise; wrong is a centre off by more than {WRONG_PX:g} px from that by"
            f" {_MANY} sub-pupils",
            "give more, as a note says; --tolerance chooses their number",
            share=0.02,
        )
    for words, modes in (("one pattern", 1.0), ("ten patterns", 10.0)):
        yield Case(
            "speckle",
            f"gaussian, {words}",
            (2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0),
            "f-number",
            partial(_speckled, modes),
            f"{here}; {wrong}",
            "sigma knows the noise of the sensor alone, and statuses the worst grains: centres"
            " scatter by what `vs.record` with speckle shows",
            share=0.02,
        )
    for words, sensor in (("12 bits", SENSOR), ("knee-point", "profile_sensor")):
        yield Case(
            "exposed too long",
            words,
            (1.0, 1.25, 1.5, 2.0, 4.0, 8.0, 16.0),
            "times a brightest pixel of 80 %",
            partial(_exposed, sensor),
            f"{FILM_PX} x {FILM_PX} px, {sensor}; {wrong}",
            "expose less, or by auto",
            share=0.02,
        )
        yield Case(
            "exposed too short",
            words,
            (1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001),
            "times a brightest pixel of 80 %",
            partial(_exposed, sensor),
            f"{FILM_PX} x {FILM_PX} px, {sensor}; {wrong}",
            "expose longer",
            share=0.03,
        )
    yield Case(
        "distortion that folds the image",
        "lens_camera",
        (-1.0, -2.0, -4.0, -8.0, -16.0, -32.0),
        "k_1",
        _folding,
        "one camera",
        "calibrate again, with marks as far as the image's corners",
    )
    yield Case(
        "a calibration of another resolution",
        "lens_camera",
        (0.0, 1.0),
        "files",
        _other_resolution,
        "one camera",
    )
    yield Case(
        "the sensor moves while its shutter rolls",
        "rows 15 us apart",
        (1.0, 10.0, 100.0, 1000.0, 10000.0),
        "mm/s towards the part",
        _rolling,
        f"{FILM_PX} x {FILM_PX} px, light alone; wrong is a centre off by more than {WRONG_PX:g} px"
        " from that of one instant",
        "a global shutter; or know the motion: `vs.render_exposure` gives each row's truth",
        silent=True,
    )


@cache
def _scene() -> Scene:
    return load_scene(SCENE, width=FILM_PX, height=FILM_PX, line_radius=1.0)


@cache
def _frame() -> Frame:
    return render_frame(_scene())


@cache
def _truth() -> TrueLine:
    return TrueLine.of_frame(_frame())


def _judged(line: LineCentres, own_px: float = SIGMAS) -> Outcome:
    """What became of the line's columns, not next to its ends."""
    columns = _truth().columns(_ENDS_PX)
    error = np.abs(line.row - _truth().row[0])[columns]
    status, sigma = line.status[columns], line.sigma[columns]
    found = judged(status, FOUND, error)
    wrong = ~found.reported & (error > WRONG_PX) & ~(error <= own_px * sigma)
    return Outcome(found.reported, wrong, found.reports, found.largest_px)


def _speckled(modes: float, f_number: float) -> Outcome:
    aperture = Aperture(f_number, pixel_um=5.5, magnification=0.25, modes=modes)
    return _judged(line_centres(record(_scene(), _frame(), sensor=SENSOR, speckle=aperture)))


def _exposed(sensor: str, times: float) -> Outcome:
    return _judged(line_centres(record(_scene(), _frame(), sensor=sensor, peak=0.8 * times)))


def _rolling(speed_mm_s: float) -> Outcome:
    towards = speed_mm_s * _scene().camera.pose.rotation[:, 2]
    frame = render_exposure(_scene(), 1e-6, towards, row_time_s=15e-6)
    return _judged(line_centres(frame), own_px=0.0)


# ------------------------------------------------------------------------------- lenses


def _through(count: int, **lens: Any) -> Scene:
    return load_scene(
        SCENE, width=FILM_PX, height=FILM_PX, line_radius=1.0, sub_pupils=count, spp=count, **lens
    )


@cache
def _blurred(count: int, behind_mm: float) -> Frame:
    return render_frame(_through(count, f_number=4, focus_distance=300.0 + behind_mm))


def _out_of_focus(count: int, behind_mm: float) -> Outcome:
    """A note on points of the pupil that are too far apart reports all columns."""
    frame = _blurred(count, behind_mm)
    best, line = line_centres(_blurred(_MANY, behind_mm)), line_centres(frame)
    good = np.flatnonzero(best.found)[3:-3]
    error = np.abs(line.row - best.row)[good]
    if any("sub_pupils" in note for note in frame_notes(frame.report)):
        every = np.ones(error.shape, bool)
        return Outcome(every, ~every, ["a note on sub_pupils"], 0.0)
    return judged(line.status[good], FOUND, error, WRONG_PX)


def _refused(make: Any) -> Outcome:
    """One item: an error is a report, and what is made without one is wrong."""
    try:
        make()
    except InputError:
        return Outcome(np.ones(1, bool), np.zeros(1, bool), ["InputError"], 0.0)
    return Outcome(np.zeros(1, bool), np.zeros(1, bool), (), 0.0)


def _folding(k_1: float) -> Outcome:
    return _refused(lambda: _through(1, distortion=f"{k_1}, 0, 0, 0"))


def _other_resolution(wrong: float) -> Outcome:
    """A calibration of a film of half as many pixels, or of the right one."""
    if not wrong:
        return Outcome(np.zeros(1, bool), np.zeros(1, bool), (), 0.0)
    camera = load_scene(SCENE, width=FILM_PX // 2, height=FILM_PX // 2).sensor
    with scratch_folder() as folder:
        path = Path(folder, "camera.yaml")
        calibration_of(camera).save(path)
        return _refused(lambda: _through(1, calibration=path))
