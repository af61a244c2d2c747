"""What `help(vs)` and `vs.<tab>` show: all public names with their first sentences."""

import inspect
import pydoc
import re
import subprocess
import sys

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.calls import public

SMALL = 'load_scene("hot_cylinder", width=512, height=512, '

HELP = """
import pydoc, sys, virtual_sensor as vs
print(pydoc.plain(pydoc.render_doc(vs)))
print(sorted({"drjit", "mitsuba", "numpy", "matplotlib"} & sys.modules.keys()))
"""


def test_the_help_is_two_pages_and_loads_nothing():
    """Rationale: 1,600 lines are read by nobody, and the engine took a second to show them."""
    ended = subprocess.run([sys.executable, "-c", HELP], capture_output=True, text=True, check=True)
    *lines, loaded = ended.stdout.splitlines()
    assert loaded == "[]"
    assert len(lines) < 220
    assert max(map(len, lines)) <= 104
    assert dir(vs) == sorted(vs.__all__)  # all others, such as <tab>, are shown all


def test_the_help_has_the_first_sentence_of_every_public_name():
    """Rationale: it stands in the module's docstring, which nothing else would keep up to date."""
    listed = " ".join(vs.__doc__.split())
    for name in vs.__all__:
        first = inspect.getdoc(getattr(vs, name)).split("\n\n")[0]
        expected = f"{name} {' '.join(first.split())}"
        assert expected in listed, f"the docstring of virtual_sensor/__init__.py lacks: {expected}"


def test_the_lines_of_the_help_run(tmp_path, monkeypatch):
    """Rationale: they are what is copied first."""
    monkeypatch.chdir(tmp_path)
    lines = re.findall(r"^>>> (.*)", vs.__doc__, re.MULTILINE)
    names: dict = {}
    exec("\n".join(lines).replace('load_scene("hot_cylinder", ', SMALL), names)
    assert np.isfinite(names["points_mm"]).all(axis=1).sum() > 200
    assert vs.read_image("shot.png").largest == names["shot"].sensor.saturation


def test_signatures_can_be_read():
    """Rationale: `ArrayLike` alone was shown as 400 characters."""
    for name in vs.__all__:
        target = getattr(vs, name)
        members = [target]
        if inspect.isclass(target) and target.__module__.startswith("virtual_sensor"):
            public_ones = (m for n, m in vars(target).items() if n[0] != "_")
            members += [getattr(m, "__func__", m) for m in public_ones]
        for member in filter(inspect.isfunction, members):
            shown = f"{inspect.signature(member)}"
            assert not re.search(r"_SupportsArray|numpy\.|<function|typing\.|\b_\w", shown), (
                f"{member.__qualname__}{shown}"
            )
    text = pydoc.plain(pydoc.render_doc(vs.line_centres))
    assert "line_centres(image: ArrayLike, method: str | Foreign = 'gaussian'" in text


def test_a_wrong_keyword_is_told_with_what_was_meant():
    """Rationale: Python says that it is wrong, and leaves the reader to look it up."""

    @public
    def measured(scene: str, length_mm: float = 1.0, *, _cache: None = None) -> str:
        return f"{scene} {length_mm}"

    assert measured("a", length_mm=2.0) == "a 2.0"
    assert f"{inspect.signature(measured)}" == "(scene: str, length_mm: float = 1.0) -> str"
    for keyword, said in {
        "lenght_mm": "it takes scene, length_mm; did you mean 'length_mm'?",
        "beta": "it takes scene, length_mm; parameters of the scene are set by scene.with_param",
    }.items():
        with pytest.raises(TypeError) as told:
            measured("a", **{keyword: 3})
        assert f"has no argument '{keyword}': {said}" in str(told.value)


def test_a_misspelt_name_is_one_that_python_can_guess():
    """Rationale: the interpreter adds "Did you mean: 'render'?" if it may look at the names."""
    with pytest.raises(AttributeError) as told:
        _ = vs.rendr  # type: ignore[attr-defined]
    assert (told.value.name, told.value.obj) == ("rendr", vs)
