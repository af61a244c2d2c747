"""Several cameras or lasers, measured pair by pair: the files of each, and a page over them."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from urllib.parse import quote

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.files import RESULTS_SIGN, folder_written_whole
from virtual_sensor.imaging.checks import FACETS_LIE
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.records import Record, write_ply
from virtual_sensor.reporting.files import FileOf, write_results
from virtual_sensor.reporting.measure import headline, save
from virtual_sensor.reporting.page import PAGE, Page, Section
from virtual_sensor.reporting.pictures import (
    Panel,
    Picture,
    draw_picture,
    from_side,
    key_above,
    side_of,
)
from virtual_sensor.reporting.style import CYCLE
from virtual_sensor.reporting.tables import Link, TextTable
from virtual_sensor.reporting.words import capital
from virtual_sensor.studies.measure import Measurement, StateSummary, Summary
from virtual_sensor.studies.provenance import made_with

Points = tuple[NDArray[np.float64], NDArray[np.float64]]
"""What a pair measures: points (N, 3) in mm, world, and the line's brightness there (N,)."""

COMMAND = "measure, several cameras or lasers"


@dataclass(frozen=True)
class PairsSummary(Record):
    """Cameras with lasers, each pair measured by itself: no other laser shines.

    Attributes
    ----------
    pairs : dict of Summary
        By the names of their folders.
    refused : dict of str
        Why a pair can't be measured.
    """

    pairs: dict[str, Summary]
    refused: dict[str, str]

    @property
    def states(self) -> list[StateSummary]:
        """Of all pairs, cold and hot."""
        return [state for figures in self.pairs.values() for state in figures.states.values()]


FILES = (
    FileOf(PAGE, "The page to open first: the pairs, and where their own pages are."),
    FileOf(
        "points_*.ply",
        "The points that all pairs measure, mm, world, with the line's brightness and the pair's"
        " number in the page's table.",
    ),
    FileOf(RESULTS_SIGN, "The figures of all pairs.", PairsSummary),
)


def pairs_of(scene: Scene) -> list[tuple[str, str]]:
    """Names of each camera with each laser."""
    return [(camera, source) for camera in scene.cameras for source in scene.sources]


def save_pairs(
    scene: Scene,
    measure: Callable[[Scene], Measurement],
    folder: Path,
    command: str,
    overwrite: bool = False,
) -> PairsSummary:
    """Measure each camera with each laser and write the results, a folder for each, or none.

    Raises
    ------
    InputError
        If no pair can be measured, or the folder exists or can't be written.
    """
    pairs: dict[str, Summary] = {}
    refused: dict[str, str] = {}
    points: dict[str, dict[str, Points]] = {}
    with folder_written_whole(folder, overwrite) as place:
        for camera, source in pairs_of(scene):
            name = f"{camera}_{source}".replace("/", "-")
            try:
                result = measure(scene.only(camera, source))
            except InputError as error:
                refused[name] = f"{error}"
            else:
                each = f"{command} --camera {camera} --source {source}"
                pairs[name] = save(result, place / name, each)
                for air, state in result.states.items():
                    points.setdefault(air, {})[name] = state.points_mm, state.brightness
        if not pairs:
            raise InputError(next(iter(refused.values())))
        made = PairsSummary(pairs, refused)
        for air, found in points.items():
            _write_joined(place / f"points_{air}.ply", found, list(pairs))
        page = _page(scene, made, _profiles(points), command)
        write_results(place, FILES, {PAGE: page, RESULTS_SIGN: made})
    return made


def _write_joined(path: Path, found: Mapping[str, Points], names: list[str]) -> None:
    """Write the points of all pairs, with each one's number from 1 on."""
    places, brightness = (np.concatenate(each) for each in zip(*found.values(), strict=True))
    counts = [len(points_mm) for points_mm, _ in found.values()]
    number = np.repeat([1 + names.index(name) for name in found], counts)
    write_ply(path, places, brightness, pair=number)


def _profiles(points: Mapping[str, Mapping[str, Points]]) -> Picture:
    """The points of all pairs from one side: in hot air, if there is any."""
    air, found = list(points.items())[-1]
    across, up = side_of(np.concatenate([points_mm for points_mm, _ in found.values()]))

    def draw(axes: Axes) -> None:
        sizes = np.linspace(9.0, 2.5, len(found)).tolist()  # what lies below others shows
        for (name, (points_mm, _)), own, ms in zip(
            found.items(), cycle(CYCLE), sizes, strict=False
        ):
            axes.plot(*points_mm[:, [across, up]].T, ".", ms=ms, color=own, label=name)
        from_side(axes, across, up)
        key_above(axes)

    title = f"What all pairs measure, in {air} air"
    alt = f"The points that each pair measures in {air} air, in one picture, a colour each."
    return draw_picture("", [Panel(title, draw, alt, width=2, layout=None)])


def pairs_table(made: PairsSummary) -> TextTable:
    """What was found by each pair; links lead to their pages."""
    rows: list[tuple[str | Link, ...]] = [
        (f"{number}", Link(name, f"{quote(name)}/{PAGE}"), capital(headline(figures)))
        for number, (name, figures) in enumerate(made.pairs.items(), start=1)
    ]
    rows += [("", name, f"Not measured: {why}") for name, why in made.refused.items()]
    return TextTable(("", "pair", "what it measures"), tuple(rows))


def pair_notes(made: PairsSummary) -> Iterable[str]:
    """Notes that all pairs have are said once, and what facets cost of the first pair only."""
    faceted = False
    for name, figures in made.pairs.items():
        others = [other.notes for other in made.pairs.values()]
        for note in figures.notes:
            if FACETS_LIE in note:
                if faceted:
                    continue
                faceted = True
            yield note if all(note in each for each in others) else f"{name}: {note}"


def _page(scene: Scene, made: PairsSummary, profiles: Picture, command: str) -> Page:
    count = len(made.pairs) + len(made.refused)
    return Page(
        f"{scene.path.stem}: {count} pairs of a camera and a laser",
        f"{len(made.pairs)} of {count} pairs are measured, each by itself: no other laser shines.",
        (Section("The pairs", profiles, pairs_table(made)),),
        command,
        made_with(),
        tuple(dict.fromkeys(pair_notes(made))),
    )
