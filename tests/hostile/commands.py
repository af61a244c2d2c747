"""Command lines with options that nobody should give, on whole files."""

from __future__ import annotations

from typing import Any

import numpy as np
from hostile import fields, import_files
from hostile.cases import Case, Result
from hostile.image_files import Picture, png
from hostile.mutations import NUMBERS
from hypothesis import strategies as st

_TEXTS = (
    "",
    "é",
    "x",
    "a" * 300,
    "-",
    "1,2",
    "1,2,3",
    "nan,nan,nan",
    "0,0,0",
    ",",
    "x,y",
    "a:b",
    "%s",
)
_DETECT = (
    "--detector", "--along", "--peaks", "--bits", "--saturation", "--noise", "--gain", "--channel",
    "--min-amplitude", "--max-width", "--calibration",
)  # fmt: skip
_IMPORT = (
    "--variable", "--quantity", "--units", "--length-units", "--axes", "--origin", "--scale",
    "--mirror", "--box", "--spacing", "--extrude", "--solid", "--ambient", "--pressure", "--time",
)  # fmt: skip
_INFO = ("--time", "--scene", "-D")
_MEASURE = ("-D", "--points", "--rays", "--detector", "--tolerance", "--spp", "--peaks")


def _field_file() -> bytes:
    axes = tuple(first + 4.0 * np.arange(6) for first in (-10.0, -10.0, 0.0))
    return fields.plain_file(axes)


@st.composite
def cases(draw):
    """A command line: files are whole, options are not."""
    picture = Picture((40, 48), 18.0, 0.05, 1.0)
    name, data, start, options = draw(
        st.sampled_from(
            (
                ("line.png", png(picture.grey(np.uint8, 255), 8), ["detect", "{in}"], _DETECT),
                ("air.csv", import_files.table("x [mm],y [mm],z [mm],T [K]", ",", False, True).data,
                 ["field", "import", "{in}"], _IMPORT),
                ("air.nc", _field_file(), ["field", "info", "{in}"], _INFO),
            )
        )
    )  # fmt: skip
    line = [*start]
    if start[0] != "field" or start[1] == "import":
        line += ["-o", "{out}"]
    for option in draw(st.lists(st.sampled_from(options), min_size=1, max_size=3)):
        value = draw(st.sampled_from((*NUMBERS, *_TEXTS)))
        if "\x00" in value:
            continue  # no command line holds it
        line += [option, f"beta={value}" if option == "-D" else value]
    made: dict[str, Any] = {"line": line}

    def judge(_: Result) -> str:
        return ""

    return Case("command", f"command/{start[-2]}", {name: data}, name, judge, made)
