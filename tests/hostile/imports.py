"""Fields of other solvers that are whole or spoilt, and what is made up in what comes of them."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from hostile.cases import Case, Result
from hostile.fields import kelvin, possible
from hostile.import_files import (
    MODES,
    SHAPES,
    Written,
    X,
    Y,
    Z,
    comsol,
    numpy_file,
    openfoam,
    table,
    vtk,
)
from hostile.mutations import (
    GARBAGE,
    cut,
    encoded,
    flipped,
    lines_changed,
    numbers_changed,
    spliced,
    stamped,
    words_changed,
)
from hypothesis import strategies as st

CSV_HEADERS = ("x [mm],y [mm],z [mm],T [K]", "x,y,z,T", "Points:0,Points:1,Points:2,T")


@st.composite
def tables(draw):
    """Tables: cheap, so most cases are such."""
    form = draw(st.sampled_from(("csv", "comsol", "numpy")))
    if form == "csv":
        marks = st.sampled_from((",", ";", "\t"))
        return table(draw(st.sampled_from(CSV_HEADERS)), draw(marks), *draw(_TWO))
    if form == "comsol":
        return comsol(draw(st.sampled_from(("rows", "grid", "csv", "sweep"))))
    return numpy_file(draw(st.sampled_from(("axes", "packed", "points", "records", "plain"))))


_TWO = st.tuples(st.booleans(), st.booleans())


@st.composite
def meshes(draw):
    """Files of VTK, and cases of OpenFOAM."""
    if draw(st.integers(0, 9)) == 0:
        return openfoam()
    at = draw(st.sampled_from(("points", "points", "cells")))
    shape = draw(st.sampled_from(SHAPES))
    if shape in ("vtp", "vtk points"):
        at = "points"
    return vtk(shape, draw(st.sampled_from(MODES)), at)


def judged(written: Written, wrong: int = 0):
    """Whether a temperature is the formula's, where the result says that it is."""

    def judge(result: Result) -> str:
        if failed := possible(result):
            return failed
        if result["kind"] != "temperature":
            return f"a {result['kind']}"
        values = result["values"]
        axes = [
            o + s * np.arange(n)
            for o, s, n in zip(result["origin"], result["spacing"], values.shape, strict=True)
        ]
        for axis, known in zip(axes, (X, Y, Z), strict=True):
            if axis[0] < known[0] - 1e-3 or axis[-1] > known[-1] + 1e-3:
                return f"an axis from {axis[0]:g} to {axis[-1]:g} mm, not {known[0]} to {known[-1]}"
        away = np.abs(values - kelvin(*np.meshgrid(*axes, indexing="ij")))
        off = away > written.near
        if off.sum() > wrong:
            return (
                f"{off.sum()} of {off.size} are off the formula, by up to {np.nanmax(away):.3g} K"
            )
        return ""

    return judge


HOSTILE_OPTIONS: dict[str, tuple[Any, ...]] = {
    "variable": ("", "é", "rho", "a" * 300),
    "quantity": ("", "index", "density", "refractivity", "pressure"),
    "units": ("", "degC", "F", "kg/m3"),
    "length_units": ("", "m", "um", "inch", "nan"),
    "axes": ("", "x", "x,x,y", "x,y,z,x", "-z,y,x", "z,x,-y", "a,b,c", "x" * 300),
    "origin_mm": ((np.nan, 0.0, 0.0), (np.inf,) * 3, (1e300,) * 3, (), (0.0,) * 4),
    "scale": (0.0, -1.0, np.nan, np.inf, 1e300, 1e-300, 1e-3),
    "mirror": (("x",), ("q",), ("x", "x"), ("",), ("z",)),
    "box_mm": ((np.nan,) * 6, (0, 0, 0, 0, 0, 0), (1, -1, 1, -1, 1, -1), (1e300,) * 6, (0.0,),
               (-np.inf, np.inf) * 3, (-6.0, 6.0, -9.0, 9.0, 4.0, 12.0)),
    "spacing_mm": ((0.0,) * 3, (-1.0,) * 3, (np.nan,) * 3, (1e-9,) * 3, (np.inf,) * 3, (1e300,) * 3,
                   (1e-300,) * 3, (), (3.0,) * 3),
    "extrude_mm": ((0.0, 0.0), (np.nan, 1.0), (-np.inf, np.inf), (5.0, -5.0), (-1e300, 1e300)),
    "solid": ("", "cylinder", "cylinder:", "cylinder:nan", "cylinder:1e999", "cylinder:5,",
              "cylinder:0", "cylinder:.", "cylinder:1.2.3", "enclosed", "none", "cylinder:5"),
    "ambient": (np.nan, np.inf, -np.inf, -1.0, 0.0, 1e300, 1e-300),
    "pressure_pa": (np.nan, np.inf, -1.0, 0.0, 1e300, 1e-300),
    "time_s": (np.nan, np.inf, -1.0, 1e300, 0.5, 1.0),
}  # fmt: skip


@st.composite
def spoilt(draw, written: Written):
    """What becomes of a file."""
    hows = ["whole", "cut", "cut", "edited", "edited", "spliced", "garbage", "options", "claims"]
    how = draw(st.sampled_from((*hows, "sealed") if written.sealed else tuple(hows)))
    data, options, judge = written.data, dict(written.options), judged(written)
    if how == "cut":
        data = draw(cut(data))
        if written.ends_in_a_number:
            # The end of the last number may be lost too: a row whose last cell is short.
            judge = judged(written, wrong=1)
    elif how == "claims":
        data = claiming_more(data, draw(st.integers(0, 40)), draw(st.sampled_from((1, 3, 10**9))))
    elif how == "sealed":
        data = draw(flipped(data, written.sealed))
    elif how == "garbage":
        data, judge = draw(GARBAGE), possible
    elif how == "options":
        for name in draw(st.lists(st.sampled_from(list(HOSTILE_OPTIONS)), min_size=1, max_size=2)):
            options[name] = draw(st.sampled_from(HOSTILE_OPTIONS[name]))
        judge = possible
    elif how == "spliced":
        data, judge = draw(spliced(data)), possible
    elif how == "edited":
        judge = possible
        if written.ascii:
            text = data.decode()
            change = draw(st.sampled_from((numbers_changed, words_changed, lines_changed, encoded)))
            data = draw(change(text))
            data = data if isinstance(data, bytes) else data.encode("utf-8", "replace")
        else:
            data = draw(draw(st.sampled_from((flipped, stamped)))(data))
    main = written.main.partition("/")[0]  # of a case the folder
    return Case(
        "import",
        f"{written.label}/{how}",
        written.spoilt(data),
        main,
        judge,
        options,
        must_be_read=how == "whole" and written.plain,
    )


def claiming_more(data: bytes, number: int, more: int) -> bytes:
    """One of the counts that a header gives, larger."""
    counts = (
        rb"(?:NumberOf(?:Points|Cells|Verts)=\"|POINTS |CELLS |CELL_TYPES |_DATA |VALUES )(\d+)"
    )
    counts += rb"|(?:WholeExtent|Piece Extent)=\"\d+ (\d+)|DIMENSIONS (\d+)|% Nodes[:,] *(\d+)"
    counts += rb"|List<scalar>\n(\d+)|'shape': \((\d+)|COORDINATES (\d+)"
    found = list(re.finditer(counts, data))
    if not found:
        return data
    match = found[number % len(found)]
    group = next(i for i in range(1, 8) if match[i])
    new = b"%d" % (int(match[group]) + more)
    return data[: match.start(group)] + new + data[match.end(group) :]


def table_cases():
    """Tables, whole or spoilt."""
    return tables().flatmap(spoilt)


def mesh_cases():
    """Meshes, whole or spoilt."""
    return meshes().flatmap(spoilt)
