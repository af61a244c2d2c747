"""Every statement of section 5 of Beermann et al. 2018, and whether our curves bear it out.

A statement of the paper's is looked for in each of our airs.  Numbers are met within 15 %, bounds
if they are kept, and where the paper only says what rises and falls, if ours does so too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from virtual_sensor.studies.reproduction import looks
from virtual_sensor.studies.reproduction.curves import Curves
from virtual_sensor.studies.reproduction.numbers import STATED, Stated


@dataclass(frozen=True)
class Statement:
    """A statement of the paper's.

    Attributes
    ----------
    where : str
        Section and figure.
    claim : str
        What is stated, in short.
    paper : str
        The paper's value, or how it says it.
    look : callable
        What we find, by all curves and the air.
    why : str
        Why ours differs where it does.
    """

    where: str
    claim: str
    paper: str
    look: looks.Look
    why: str = ""


@dataclass(frozen=True)
class Verdict:
    """A statement with what was found in each air.

    `words` is the verdict; `why` is empty where ours bears the paper out in every air.
    """

    statement: Statement
    found: Mapping[str, looks.Found]
    words: str
    why: str


PLUME = (
    "the resolved plume is narrow (half width 5 mm): its flanks, a lens across y, lie within the"
    " nine rays and bend both paths several times as much as the paper's broad one"
)
NARROW = "the largest displacement lies on the plume's flank near y = -5 mm, within the nine rays"
STEEP = (
    "at y = -10 mm the surface is so steep (48 deg) that the displacement of -4 px in u, which the"
    " paper states, comes with some 100 µm in z; a blur takes the plume's heart away, and with it"
    " the deviation at y = 0. A plume that is wide *and* hot in its middle (widened) shows the"
    " paper's order"
)
ROUNDED = (
    "half a step is 2.75 µm along each axis of the sensor, as the paper says; in space both axes"
    " add, and the inclined laser plane stretches one. The largest of nine lies between 2.6 and"
    " 4.2 µm, by where the raster of 0.25 px is laid; with its nodes on pixel centres it is ours"
)


def judge(curves: Curves, airs: Sequence[str]) -> list[Verdict]:
    """Look for all statements in some airs."""
    verdicts = []
    for statement in STATEMENTS:
        found = {air: statement.look(curves, air) for air in airs}
        kept = [air for air, each in found.items() if each.met]
        words = "met" if len(kept) == len(airs) else "differs"
        if kept and len(kept) < len(airs):
            words = f"met in {' and '.join(kept)} air only"
        why = "" if len(kept) == len(airs) else statement.why
        verdicts.append(Verdict(statement, found, words, why))
    return verdicts


def _number(stated: Stated, why: str) -> Statement:
    def look(curves: Curves, air: str) -> looks.Found:
        ours = stated.ours(curves.rays(air, stated.temperature_c, stated.beta_deg))
        return looks.Found(f"{ours:.3g} {stated.unit}", stated.met(ours))

    paper = f"{stated.kind.value} {stated.paper:g} {stated.unit}"
    pose = f" ({stated.temperature_c:g} °C)" if stated.beta_deg else ""
    return Statement(stated.where, stated.name + pose, paper, look, why)


_BIG, _LO, _OC, _MEAN, _B15, _B30 = STATED

STATEMENTS = (
    Statement("5.1, fig. 6", "h_d_min of all nine rays", "below 1 µm", looks.helper),
    Statement(
        "5.1, fig. 7(a)",
        "Δy of B - A falls with -y",
        "continuously",
        looks.steps(lambda c: c.exact.incidence_um[:, 1], -1.0),
        NARROW,
    ),
    Statement(
        "5.1, fig. 7(a)",
        "Δz of B - A falls with -y",
        "continuously",
        looks.steps(lambda c: c.exact.incidence_um[:, 2], -1.0),
        NARROW,
    ),
    Statement(
        "5.1, fig. 7(a)",
        "Δx of B - A rises with -y",
        "increases",
        looks.steps(lambda c: c.exact.incidence_um[:, 0], 1.0),
        NARROW,
    ),
    Statement(
        "5.1, fig. 7(a)",
        "curvature does not boost B - A at y = 0",
        "not or only slightly",
        looks.flat_top,
    ),
    _number(_BIG, PLUME),
    Statement(
        "5.1, fig. 7(b)", "the deviation can't be neglected", "demonstrated", looks.not_negligible
    ),
    Statement(
        "5.1, fig. 7(e)",
        "cold |A - A_m|, rounded to 0.25 px, at most",
        "about 2.7 µm",
        looks.cold_distance,
        ROUNDED,
    ),
    Statement(
        "5.1, fig. 7(e)",
        "the same along an axis of the sensor: half a step of 5.5 µm",
        "2.75 µm",
        looks.cold_axis,
    ),
    Statement("5.1, fig. 7(e)", "it is discretisation only", "exclusively", looks.cold_exact),
    Statement(
        "5.1, fig. 7(c)",
        "|B_m - A_m| falls from region I into II, and rises again in III",
        "decreases, lowest, increases",
        looks.dip,
        PLUME,
    ),
    Statement(
        "5.1, fig. 7(c)", "|B_m - A_m| is largest at y = 0", "maximum", looks.maximum_at_0, STEEP
    ),
    Statement(
        "5.2, fig. 7(d)",
        "region II, of the least displacement, is at y = -7.5 mm (or a ray beside it)",
        "y = -7.5 mm",
        looks.region_2,
        "where the two paths' effects cancel moves outward as the plume gets wider; see the widened"
        " one",
    ),
    Statement(
        "5.1, fig. 7(c, d)", "d_euclid,xyz and d_euclid,uv are correlated", "yes", looks.alike
    ),
    Statement(
        "5.1, fig. 7(a, c)",
        "a further moved spot may be measured with less deviation",
        "oddly enough",
        looks.oddly,
    ),
    _number(_LO, PLUME),
    Statement(
        "5.2, fig. 9(a)",
        "Δu laser → object decreases with -y",
        "is decreasing",
        looks.steps(lambda c: c.paths.laser_to_object_px[:, 0], -1.0),
        NARROW,
    ),
    _number(_OC, PLUME),
    Statement(
        "5.2, fig. 9(b)",
        "Δu object → camera increases with -y",
        "increases",
        looks.steps(lambda c: c.paths.object_to_camera_px[:, 0], 1.0),
        NARROW,
    ),
    Statement("5.2, fig. 9", "the two paths deflect opposite ways in u", "opposite", looks.opposed),
    _number(_MEAN, PLUME),
    Statement("5.2, fig. 9(c)", "it is the same as fig. 7(d)", "the same", looks.same_sum),
    Statement(
        "5.2, fig. 9(d-f)",
        "at y = -7.5 mm both paths together displace less than either",
        "a reduction",
        looks.reduced,
        PLUME,
    ),
    Statement(
        "5.2, fig. 10(b)",
        "rounding changes fig. 7(d) only slightly",
        "slight difference",
        looks.slightly,
    ),
    Statement(
        "5.2, fig. 10(b)", "with 0.5 px the difference would be bigger", "bigger", looks.coarser
    ),
    Statement("5.2, fig. 10", "at y = 0 light is not deflected in y", "marginally", looks.marginal),
    Statement("5.2, fig. 10(a)", "at y = 0, B_m lies above the surface", "above", looks.above),
    Statement(
        "5.3, fig. 11(a)",
        "hotter is more |B_m - A_m| from y = 0 to -5 mm",
        "an increase",
        looks.hotter(looks.measured),
    ),
    Statement(
        "5.3, fig. 11(a)",
        "hotter makes no difference from y = -5 to -10 mm",
        "no differences",
        looks.no_difference,
        "hotter air bends light more everywhere, by a nearly common factor; the difference is small"
        " where the deviation is small, in region II, which lies elsewhere in this air",
    ),
    Statement("5.3, fig. 11(a)", "except at y = -10 mm", "except", looks.except_last, PLUME),
    Statement("5.3, fig. 11(a.2)", "rounded curves show more abrupt steps", "more", looks.steppier),
    Statement(
        "5.3, fig. 11(c)",
        "hotter is more pixel displacement from y = 0 to -5 mm",
        "an increase",
        looks.hotter(looks.displaced),
    ),
    Statement(
        "5.3, fig. 11(d)",
        "the pixel displacement shrinks with beta: 0, 15, 30 deg (900 °C)",
        "reduced",
        looks.turned,
    ),
    _number(_B15, "a plume widened at its full heat reaches further to the side than the paper's"),
    _number(_B30, "a plume widened at its full heat reaches further to the side than the paper's"),
    Statement("5.3", "measuring from the side is more trustworthy", "obvious", looks.sideways),
)
