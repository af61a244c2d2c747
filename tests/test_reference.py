"""The reference says what the program says, and leaves nothing public out."""

import dataclasses
import importlib
import inspect
import re
import sys
from enum import Enum
from pathlib import Path

import pytest

import virtual_sensor as vs

DOCS = Path(__file__).parents[1] / "docs"


@pytest.fixture(scope="module")
def maker():
    """The program that writes the pages."""
    sys.path.insert(0, str(DOCS))
    try:
        yield importlib.import_module("make_reference")
    finally:
        sys.path.remove(str(DOCS))


def test_the_generated_pages_are_as_the_program_makes_them(maker):
    """Rationale: a reference that is written by hand lists what there once was."""
    for name, page in maker.PAGES.items():
        text = (maker.FOLDER / name).read_text(encoding="utf-8")
        assert text == page(), f"{name}: run `python docs/make_reference.py`"


def test_every_public_name_is_listed_and_described(maker):
    """Those of `vs`, and the classes that these lead to: their fields and parameters too."""
    pages = (maker.FOLDER / name for name in ("api.md", "api_classes.md"))
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    public = [getattr(vs, name) for name in vs.__all__]
    kinds = maker.reached_classes(public)
    assert {"Scene", "Frame", "FoundPixels", "Pinhole"} <= {kind.__name__ for kind in kinds}
    assert all(f"### vs.{name}\n" in text for name in vs.__all__)
    missing = []
    for target in {*public, *kinds}:
        assert f"::: {target.__module__}.{target.__qualname__}\n" in text
        missing += [f"{target.__qualname__}: {name}" for name in undescribed(target)]
    assert not missing, "\n".join(missing)


def undescribed(target):
    """Parameters of a function, fields of a class, that its docstring does not mention."""
    words = inspect.getdoc(target) or ""
    if inspect.isfunction(target):
        names = list(inspect.signature(target).parameters)
    elif dataclasses.is_dataclass(target):
        own = [kind.__doc__ or "" for kind in target.__mro__ if dataclasses.is_dataclass(kind)]
        words = "\n".join(map(inspect.cleandoc, own))
        names = [each.name for each in dataclasses.fields(target)]
    else:
        names = []
    listed = {
        name.strip().lstrip("*")
        for line in re.findall(r"^([\w*, ]+?)(?: :.*)?$", words, re.MULTILINE)
        for name in line.split(",")
    }
    if not words or (inspect.isclass(target) and issubclass(target, Enum) and not target.__doc__):
        yield "itself"
    yield from (name for name in names if not name.startswith("_") and name not in listed)


def test_every_status_says_what_it_means(maker):
    """Rationale: a number beside a NaN answers nothing."""
    kinds = maker.status_kinds()
    assert {"Status", "SearchStatus", "RayStatus", "FitStatus"} <= {k.__name__ for k in kinds}
    for kind in kinds:
        assert all(member.message.endswith(".") for member in kind), kind


def test_the_glossary_names_columns_that_files_have():
    """Rationale: it ties the paper's letters to them."""
    named = re.findall(r"`(\w+_[mu]m)` \|", (DOCS / "reference/glossary.md").read_text("utf-8"))
    columns = (DOCS / "reference/data_dictionary.md").read_text("utf-8")
    assert len(named) == 8
    assert all(f"| `{name}` |" in columns for name in named)
