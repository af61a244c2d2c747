"""Several cameras or lasers, measured pair by pair: the files of each, and a page over them."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from virtual_sensor.errors import InputError
from virtual_sensor.files import RESULTS_SIGN, folder_written_whole
from virtual_sensor.imaging.checks import FACETS_LIE
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.records import Record
from virtual_sensor.reporting.files import FileOf, write_results
from virtual_sensor.reporting.measure import headline, save
from virtual_sensor.reporting.page import PAGE, Page, Section
from virtual_sensor.reporting.tables import Link, TextTable
from virtual_sensor.reporting.words import capital
from virtual_sensor.studies.measure import Measurement, StateSummary, Summary
from virtual_sensor.studies.provenance import made_with

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
        if not pairs:
            raise InputError(next(iter(refused.values())))
        made = PairsSummary(pairs, refused)
        write_results(place, FILES, {PAGE: _page(scene, made, command), RESULTS_SIGN: made})
    return made


def pairs_table(made: PairsSummary) -> TextTable:
    """What was found by each pair; links lead to their pages."""
    rows: list[tuple[str | Link, ...]] = [
        (Link(name, f"{quote(name)}/{PAGE}"), capital(headline(figures)))
        for name, figures in made.pairs.items()
    ]
    rows += [(name, f"Not measured: {why}") for name, why in made.refused.items()]
    return TextTable(("pair", "what it measures"), tuple(rows))


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


def _page(scene: Scene, made: PairsSummary, command: str) -> Page:
    count = len(made.pairs) + len(made.refused)
    return Page(
        f"{scene.path.stem}: {count} pairs of a camera and a laser",
        f"{len(made.pairs)} of {count} pairs are measured, each by itself: no other laser shines.",
        (Section("The pairs", pairs_table(made)),),
        command,
        made_with(),
        tuple(dict.fromkeys(pair_notes(made))),
    )
