"""Objects speak: a line, a table with a picture, files, data frames."""

import dataclasses
import importlib
import json
import pkgutil
import sys

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure

import virtual_sensor
from virtual_sensor.display import LONGEST_LINE, Displayed
from virtual_sensor.errors import InputError
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.metrology.centres import LineCentres
from virtual_sensor.poses import Pose
from virtual_sensor.reporting import objects

ROW = np.array([1021.0, np.nan, 1279.0, 1100.0])


@pytest.fixture
def line():
    return LineCentres.of_rows(ROW)


def test_a_line_says_how_many_centres_it_has(line):
    assert repr(line) == "LineCentres: 3 of 4 ok, rows 1021 to 1279"
    assert repr(LineCentres.of_rows(np.zeros(0))) == "LineCentres: 0 of 0 ok"
    assert repr(LineCentres.of_rows(np.full(3, np.nan))) == "LineCentres: 0 of 3 ok"


def test_a_repr_is_one_short_line_whatever_is_in_the_object():
    class Chatty(Displayed):
        def _line(self):
            return "much\nof \x1b it " * 100

    class Broken(Displayed):
        def _line(self):
            raise KeyError("half made")

    assert LONGEST_LINE - 5 < len(repr(Chatty())) <= LONGEST_LINE
    assert repr(Chatty()).isprintable()
    assert repr(Broken()) == "Broken"


# Rooms whose dataclasses come into users' hands; what is not frozen is state, and nobody's result.
ROOMS = ("poses", "engine", "medium", "optics", "devices", "imaging", "metrology", "studies")
INTERNAL = (
    "virtual_sensor.imaging.new_scene",  # it gives a path
    "virtual_sensor.imaging.scene_file",
    "virtual_sensor.medium.heat_flow.mesh",
    "virtual_sensor.medium.heat_flow.openfoam",
    "virtual_sensor.medium.heat_flow.sample",
    "virtual_sensor.medium.heat_flow.snapped_mesh",
    "virtual_sensor.medium.heat_flow.solver",
    "virtual_sensor.medium.imports",
    "virtual_sensor.medium.lookups",
    "virtual_sensor.medium.netcdf_elements",
    "virtual_sensor.metrology.air_problem",
    "virtual_sensor.metrology.unknowns",
)


def dataclasses_of_users():
    """All public frozen dataclasses of the rooms."""
    for each in pkgutil.walk_packages(virtual_sensor.__path__, "virtual_sensor."):
        if each.name.split(".")[1] in ROOMS and not each.name.startswith(INTERNAL):
            for name, kind in vars(importlib.import_module(each.name)).items():
                own = isinstance(kind, type) and kind.__module__ == each.name
                public = own and dataclasses.is_dataclass(kind) and not name.startswith("_")
                if public and kind.__dataclass_params__.frozen:
                    yield kind


def test_every_object_that_a_user_meets_speaks():
    kinds = list(dataclasses_of_users())
    assert len(kinds) > 100
    silent = [each for each in kinds if each.__repr__ is not Displayed.__repr__]
    assert silent == [], "let them inherit Displayed, of virtual_sensor.display"


def test_what_is_drawn_is_an_object_of_ours():
    for name in objects.drawn_classes():
        module, _, kind = name.rpartition(".")
        found = getattr(importlib.import_module(f"virtual_sensor.{module}"), kind)
        assert issubclass(found, Displayed), name


def test_a_notebook_shows_line_table_and_picture_and_is_told_no_error(line, monkeypatch):
    html = line._repr_html_()
    assert "3 of 4 ok" in html
    assert "3 ok" in html
    assert "1 no_peak" in html
    assert "data:image/png;base64," in html
    broken = LineCentres.of_rows(ROW)
    object.__setattr__(broken, "status", "no array")
    assert "LineCentres" in broken._repr_html_()


def test_a_plot_leaves_the_users_matplotlib_as_it_was(line, monkeypatch):
    matplotlib.get_backend()  # it is chosen when first asked for
    before = matplotlib.rcParams.copy()
    axes = Figure().add_subplot()
    assert line.plot(axes) is axes
    assert axes.lines
    first_figure = pyplot.figure

    def starting(**options):
        matplotlib.rcParams["interactive"] = True  # as a notebook's backend when it starts
        return first_figure(**options)

    monkeypatch.setattr(pyplot, "figure", starting)
    own = line.plot()
    pyplot.close(own.figure)
    assert matplotlib.is_interactive()
    matplotlib.rcParams["interactive"] = before["interactive"]
    line._repr_html_()
    assert matplotlib.rcParams == before
    with pytest.raises(InputError, match="give an Axes"):
        line.plot("here")


def test_it_is_saved_as_its_suffix_says_or_not_at_all(line, tmp_path):
    for name in ("a.csv", "a b.json", "ü.npz", "a.PNG", "a.svg", "a.pdf"):
        assert line.save(tmp_path / name).stat().st_size > 100
    read = json.loads((tmp_path / "a b.json").read_text())
    assert read["row"] == [1021.0, None, 1279.0, 1100.0]
    assert read["status"] == ["ok", "no_peak", "ok", "ok"]
    np.testing.assert_array_equal(np.load(tmp_path / "ü.npz")["row"], ROW)
    with pytest.raises(InputError, match=r"a\.xlsx: .*\.csv, \.json, \.npz, \.pdf, \.png or \.svg"):
        line.save(str(tmp_path / "a.xlsx"))
    with pytest.raises(InputError, match=r"a\.csv"):
        line.save(tmp_path / "a.csv" / "b.csv")
    assert not list(tmp_path.glob(".*"))


def test_a_data_frame_has_a_row_for_each_centre(line):
    frame = line.to_dataframe()
    assert frame["status"].tolist() == ["ok", "no_peak", "ok", "ok"]
    assert frame["row"].iloc[2] == 1279.0


def test_objects_are_equal_by_their_fields_and_have_a_hash(line, monkeypatch):
    """Rationale: == of line centres raised "truth value is ambiguous"; that of fields was False."""
    same, other = LineCentres.of_rows(ROW.copy()), LineCentres.of_rows(ROW + 1.0)
    assert line == same
    assert hash(line) == hash(same)
    assert line != other
    assert line != "line"
    assert {line, same, other} == {line, other}
    nodes = np.linspace(1e-4, 2e-4, 125).reshape(5, 5, 5)
    make = IndexField.from_arrays
    one, two = (make(nodes.copy(), (0, 0, 0), (1, 1, 1), ambient=2e-4) for _ in range(2))
    one.refractivity([[1.0, 2.0, 3.0]])  # what it keeps for lookups is none of it
    assert one == two
    with monkeypatch.context() as shutdown:  # weak references are dropped then, by hashes
        shutdown.setattr(sys, "meta_path", None)
        shutdown.delitem(sys.modules, "numpy")
        assert hash(one) == hash(two)
    assert one != two.moved(Pose.shift((1.0, 0.0, 0.0)))
    for kind in dataclasses_of_users():
        assert kind.__hash__ is not None, kind
