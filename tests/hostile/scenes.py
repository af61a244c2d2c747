"""Scenes that are whole or spoilt, and what is made up in their frames."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from hostile.cases import Case, Result
from hostile.mutations import (
    ENCODINGS,
    GARBAGE,
    NUMBERS,
    WORDS,
    cut,
    encoded,
    flipped,
    lines_changed,
    numbers_changed,
    spliced,
    stamped,
    words_changed,
)
from hostile.scene_files import CYLINDER, FILE, PARTS, Written, line_rows, part, scene
from hypothesis import strategies as st

NEAR_PX = 0.5
OK = 0  # Status.OK


def judged(written: Written, said: dict[str, Any] | None = None):
    """Whether each ok centre is where the line is, and there are any."""

    def judge(result: Result) -> str:
        if failed := possible(result):
            return failed
        columns, rows = line_rows(written.flat, said or {})
        good = (result["status"] == OK) & (result["column"] > columns[0] + 1.5)
        good &= result["column"] < columns[-1] - 1.5
        away = result["row"] - np.interp(result["column"], columns, rows)
        if np.abs(away[good]).max(initial=0.0) > NEAR_PX:
            return f"a centre is {np.abs(away[good]).max():.3g} px off the line, and ok"
        return ""

    return judge


def possible(result: Result) -> str:
    """Whether a frame of a scene that nobody knows is one at all."""
    frame = result["pixels"]
    if not np.isfinite(frame).all() or frame.min() < 0.0:
        return f"radiances from {np.nanmin(frame):g}, {np.isnan(frame).sum()} of them NaN"
    good = result["status"] == OK
    if not np.isfinite(result["row"][good]).all():
        return "a centre is ok, and nowhere"
    if good.any() and not frame.any():
        return "centres in a black frame"
    return ""


@st.composite
def written(draw):
    """A whole scene."""
    if draw(st.booleans()):
        return Written({"scene.xml": scene(CYLINDER).encode()}, "cylinder")
    form, quads = draw(st.sampled_from(PARTS)), draw(st.booleans())
    ending, data = part(form, quads)
    text = scene(FILE.format(kind=ending, ending=ending))
    plain = ending == "ply" and not quads and form.startswith("binary") and "float" in form
    files = {"scene.xml": text.encode(), f"part.{ending}": data}
    return Written(files, f"plate {form}", f"part.{ending}", True, plain)


PARAMETERS = {
    "alpha": (20, 45, 60.5, 0, 90, 180), "tilt": (-30, -10, 0, 25, 90), "line_length": (5, 22.5),
    "line_radius": (0.6, 1.2, 0.001), "fan": (0, 5, 90), "dots": ("", "-5, 0, 5", "0", "1"),
    "width": (48, 64, 3), "height": (32, 64, 1), "spp": (1, 4, 7, 16, 10000),
}  # fmt: skip
KNOWN = {
    "alpha": (30.0, 45.0, 60.5, 70.0), "tilt": (-30.0, -20.5, -10.0), "line_length": (15.0, 20.5),
    "line_radius": (0.7, 0.9), "width": (48, 64, 81), "spp": (1, 4, 9),
}  # fmt: skip


@st.composite
def parameters(draw):
    """Some parameters, any of them hostile."""
    names = draw(st.lists(st.sampled_from(list(PARAMETERS)), min_size=1, max_size=2, unique=True))
    hostile = (*NUMBERS, *WORDS[:6], "1e-30", "1e30", "65536", "100000", "3.5", "-3", "1, 2")
    sensible = {n: tuple(map(str, PARAMETERS[n])) for n in names}
    return {n: draw(st.sampled_from((*sensible[n], *hostile))) for n in names}


@st.composite
def elements_changed(draw, text: str):
    """Elements of an XML text lost, doubled, put into each other, or of other type or value."""
    for _ in range(draw(st.integers(1, 2))):
        kind = draw(st.sampled_from(("lose", "double", "nest", "type", "value", "add")))
        tags = list(re.finditer(r"[ ]*<(\w+)[^>]*?(?:/>|>.*?</\1>)\n?", text, re.DOTALL))
        values = list(re.finditer(r'(\w+)="([^"]*)"', text))
        if kind in ("type", "value") and values:
            at = draw(st.sampled_from(values))
            new = draw(st.sampled_from((*NUMBERS, *WORDS, *TYPES)))
            text = f"{text[: at.start(2)]}{_escaped(new)}{text[at.end(2) :]}"
        elif kind == "add":
            inner = [m.end() for m in re.finditer(r"<(?:scene|shape|bsdf|emitter)[^>]*>\n", text)]
            if inner:
                at = draw(st.sampled_from(inner))
                text = text[:at] + draw(st.sampled_from(ADDED)) + text[at:]
        else:
            body = text.find("<integrator")
            tags = list(re.finditer(tags[0].re, text[body:])) if tags and body > 0 else []
            if not tags:
                continue
            at = draw(st.sampled_from(tags))
            first, end = body + at.start(), body + at.end()
            piece = text[first:end]
            if kind == "lose":
                text = text[:first] + text[end:]
            elif kind == "double":
                text = text[:end] + piece + text[end:]
            else:
                inside = piece.find(">\n")
                text = text[: first + inside + 2] + piece + text[first + inside + 2 :]
    return text


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


TYPES = (
    "path", "direct", "orthographic", "thinlens", "sphere", "rectangle", "cube", "conductor",
    "dielectric", "roughconductor", "twosided", "mask", "projector", "point", "constant",
    "area", "independent", "multijitter", "gaussian", "rgb", "float16", "uint32", "specfilm",
    "laser_line", "glow", "refractive", "homogeneous", "medium", "instance", "shapegroup",
    "sdfgrid", "bsplinecurve",
)  # fmt: skip
ADDED = (
    '<include filename="scene.xml"/>\n', '<include filename="nosuch.xml"/>\n',
    '<shape type="sphere"><float name="radius" value="nan"/></shape>\n',
    '<shape type="sphere"><float name="radius" value="1e30"/></shape>\n',
    '<shape type="sphere"><float name="radius" value="0"/></shape>\n',
    '<shape type="rectangle"/>\n', '<shape type="sphere"><point name="center" z="300"/></shape>\n',
    '<emitter type="constant"/>\n',
    '<emitter type="constant"><float name="radiance" value="nan"/></emitter>\n',
    '<emitter type="point"><point name="position" z="100"/></emitter>\n',
    '<bsdf type="null"/>\n', '<ref id="nosuch"/>\n', '<ref id="camera"/>\n', '<ref id="part"/>\n',
    '<float name="radius" value="1"/>\n', '<string name="filename" value="/dev/zero"/>\n',
    '<string name="field" value="nosuch.nc"/>\n', '<default name="alpha" value="$alpha"/>\n',
    '<default name="a" value="$b"/><default name="b" value="$a"/>\n', '<path value="/"/>\n',
    '<alias id="part" as="other"/>\n', '<!-- ', '<![CDATA[', '<?php ?>\n',
    '<scene version="9.9.9"/>\n',
    '<transform name="to_world"><scale value="0"/></transform>\n',
    '<transform name="to_world"><scale x="1" y="-1" z="2"/></transform>\n',
    '<transform name="to_world"><matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 nan"/></transform>\n',
    '<medium type="homogeneous" name="interior"/>\n', '<sensor type="perspective"/>\n',
    '<float name="temperature" value="nan"/>\n', '<float name="emissivity" value="0.8"/>\n',
)  # fmt: skip


@st.composite
def nested(draw):
    """Deep, long or growing texts."""
    deep, kind = draw(st.sampled_from((3, 50, 1000, 10_000))), draw(st.integers(0, 5))
    if kind == 0:
        inside = '<shape type="sphere">' * deep + "</shape>" * deep
    elif kind == 1:
        inside = '<bsdf type="twosided">' * min(deep, 1000) + "</bsdf>" * min(deep, 1000)
    elif kind == 2:
        more = "".join(
            f'<default name="p{i}" value="{f"$p{i - 1}" * 30 if i else "x" * 30}"/>\n'
            for i in range(min(deep, 8))
        )
        return scene(CYLINDER).replace("<integrator", more + "<integrator", 1)
    elif kind == 3:
        entities = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10 if i else "x"}">' for i in range(9))
        declared = f"<!DOCTYPE scene [{entities}]>\n"
        return scene(CYLINDER, declared).replace('value="0.1"', 'value="&e8;"')
    elif kind == 4:
        inside = f'<string name="{"n" * deep}" value="{"v" * deep}"/>'
    else:
        inside = "<!-- x -->" * deep
    return scene(CYLINDER + inside)


@st.composite
def cases(draw):
    """A scene that is whole, or spoilt."""
    whole = draw(written())
    hows = ("whole", "known", "parameters", "parameters", "elements", "elements", "text", "cut",
            "encoded", "nested", "garbage", "part", "part", "part cut", "missing")  # fmt: skip
    how = draw(st.sampled_from(hows))
    files, text = dict(whole.files), whole.files["scene.xml"].decode()
    options: dict[str, Any] = {}
    judge = judged(whole)
    if how in ("part", "part cut", "missing") and not whole.part:
        how = "known"
    if how == "known":
        names = draw(st.lists(st.sampled_from(list(KNOWN)), min_size=1, max_size=3, unique=True))
        options = {n: draw(st.sampled_from(KNOWN[n])) for n in names}
        judge = judged(whole, options)
    elif how == "parameters":
        options, judge = draw(parameters()), possible
    elif how == "elements":
        files["scene.xml"], judge = (
            draw(elements_changed(text)).encode("utf-8", "replace"),
            possible,
        )
    elif how == "text":
        change = draw(st.sampled_from((numbers_changed, words_changed, lines_changed)))
        files["scene.xml"], judge = draw(change(text)).encode("utf-8", "replace"), possible
    elif how == "cut":
        files["scene.xml"] = draw(cut(whole.files["scene.xml"]))
    elif how == "encoded":
        if draw(st.booleans()):
            name = draw(st.sampled_from((*ENCODINGS, "foo", "utf-32", "")))
            told = text.replace("utf-8", name, 1).replace("<scene", "<!-- \xe9 -->\n<scene", 1)
            known = name if name in ENCODINGS else "utf-8"
            files["scene.xml"] = told.encode(draw(st.sampled_from((known, "utf-8", "latin-1"))))
        else:
            files["scene.xml"], judge = draw(encoded(text)), possible
    elif how == "nested":
        files["scene.xml"], judge = draw(nested()).encode(), possible
    elif how == "garbage":
        files["scene.xml"], judge = draw(GARBAGE), possible
    elif how == "part":
        data = files[whole.part]
        choices = [flipped(data), stamped(data), spliced(data)]
        if not re.search(rb"binary", data[:60]) and data.isascii():
            choices += [numbers_changed(data.decode()), lines_changed(data.decode())]
        made = draw(draw(st.sampled_from(choices)))
        files[whole.part] = made if isinstance(made, bytes) else made.encode("utf-8", "replace")
        judge = possible
    elif how == "part cut":
        files[whole.part] = draw(cut(files[whole.part]))
    elif how == "missing":
        if draw(st.booleans()):
            del files[whole.part]
        else:
            files[whole.part] = draw(st.sampled_from(("fifo", "folder", "loop", b"")))
    return Case(
        "scene",
        f"{whole.label}/{how}",
        files,
        "scene.xml",
        judge,
        options,
        must_be_read=how in ("whole", "known") and whole.plain,
    )
