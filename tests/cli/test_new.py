"""The command `new`, where somebody is there to be asked."""

import builtins
import sys

import trimesh

from virtual_sensor.cli import new, shared
from virtual_sensor.imaging.new_scene.options import NewScene


def test_what_matters_is_asked_for_in_a_terminal_and_nowhere_else(monkeypatch, capsys, tmp_path):
    """A wrong answer is asked for again; Enter takes what is in brackets; Ctrl-D ends it."""
    said = iter([])

    def answered(prompt=""):
        try:
            return next(said)
        except StopIteration:
            raise EOFError from None

    monkeypatch.setattr(builtins, "input", answered)
    assert new._asked(NewScene()) == NewScene()  # piped
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(shared.console, "_force_terminal", True)
    said = iter(["nope.stl", "", "30", "", "", "x", "400", "900"])
    told = {"diameter_mm": 30.0, "distance_mm": 400.0, "temperature_c": 900.0}
    assert new._asked(NewScene()) == NewScene(**told)
    printed = capsys.readouterr().out
    assert "File of the part [none: a cylinder]: " in printed
    assert "nope.stl: can't be read" in printed
    assert "x is no number" in printed
    assert "Distance, mm [chosen to suit]: " in printed
    assert new._asked(NewScene("bracket.stl")) == NewScene("bracket.stl")
    small = f"{tmp_path / 'plate.stl'}"
    trimesh.creation.box((0.05, 0.08, 0.0075)).export(small)
    said = iter(["yard", "in"])
    assert new._asked(NewScene(small)) == NewScene(small, "in")
    said = iter([""])
    assert new._asked(NewScene(small)) == NewScene(small, "m")
    assert "plate.stl is 0.05 x 0.08 x 0.0075: in which unit [m]: " in capsys.readouterr().out
    assert new._asked(NewScene(from_scene="hot_cylinder")) == NewScene(from_scene="hot_cylinder")
    said = iter([])
    assert new._asked(NewScene()) == NewScene()
