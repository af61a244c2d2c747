"""What is said of light that a part reflects onto itself: in frames, and before they are made."""

from dataclasses import dataclass

import numpy as np

from virtual_sensor.imaging.render import DIRECT, Frame
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.imaging.self_lighting import self_lighting
from virtual_sensor.records import Record

_NOTED = 0.05  # of the line's brightness, in a tenth of its columns
_NEARLY_ALL = 0.95  # of the columns


@dataclass(frozen=True)
class GhostFacts(Record):
    """Light of the laser that the part reflects onto itself, beside the line, in the ideal frame.

    Attributes
    ----------
    bounces : int
        Reflections in between that were rendered, at most.
    columns : int
        Columns of the image with light of the line.
    ghost_columns : int
        Those of them with a ghost of a hundredth of the line or more.
    ghost_over_line : float
        How bright the brightest ghost of a column is beside its line: the median of all columns.
    largest_ghost_over_line : float
        The same, the largest of 95 % of the columns.
    indirect_share : float
        Of the laser's light in the frame.
    """

    bounces: int
    columns: int
    ghost_columns: int
    ghost_over_line: float
    largest_ghost_over_line: float
    indirect_share: float


def ghost_facts(frame: Frame) -> GhostFacts | None:
    """How much of a frame's light was reflected in between; None of direct light alone."""
    columns = frame.ghost_columns
    if columns is None or frame.direct is None or frame.indirect is None:
        return None
    over = columns.over_line
    direct, indirect = (float(each.sum(dtype=float)) for each in (frame.direct, frame.indirect))
    return GhostFacts(
        bounces=len(frame.indirect),
        columns=columns.column.size,
        ghost_columns=int(columns.seen.sum()),
        ghost_over_line=float(np.median(over)) if over.size else np.nan,
        largest_ghost_over_line=float(np.quantile(over, _NEARLY_ALL)) if over.size else np.nan,
        indirect_share=indirect / (direct + indirect) if direct + indirect else np.nan,
    )


def bounces(scene: Scene) -> list[str]:
    """Note of light that the part throws onto itself: left out, or bent on its way there.

    Some hundredths of a second.
    """
    found = self_lighting(scene)
    if scene.max_depth == DIRECT:
        if not found.ghost_over_line >= _NOTED:
            return []
        parameter = "-D max_depth=3" if "max_depth" in scene.parameters else "max_depth 3"
        return [
            f"the part throws {found.share:.0%} of the light that it reflects onto itself: ghosts"
            f" are about {found.ghost_over_line:.1g} times as bright as the line, or more, in a"
            f" tenth of its columns; direct light alone was rendered, without them: {parameter} has"
            " them"
        ]
    if scene.medium is None or not found.bent_px > 0.0:
        return []
    return [
        "light runs straight from one surface of the part to another: the air would move ghosts by"
        f" up to {found.bent_px:.1g} px"
    ]
