"""What `field convergence` writes: table, picture, page, figures."""

import csv
import json
from dataclasses import replace

import pytest
from command_line import command
from data_dictionary import undocumented
from invented_convergence import invented

from virtual_sensor.errors import InputError
from virtual_sensor.reporting import convergence as reporting


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Folder of an invented study."""
    folder = tmp_path_factory.mktemp("convergence") / "out"
    reporting.save(invented(), folder, "virtual-sensor field convergence -o out")
    return folder


def test_results_are_written_with_table_picture_page_and_summary(written):
    """Rationale: people open the page, the documentation takes the table, programs the rest."""
    assert sorted(p.name for p in written.iterdir()) == [
        *("convergence.csv", "convergence.md", "convergence.png", "report.html", "summary.json")
    ]
    assert undocumented(written, reporting.FILES) == []
    with (written / "convergence.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(invented().changes) + 1
    assert (float(rows[0]["line_px"]), float(rows[-1]["time_s"])) == (0.36, 15.0)
    summary = json.loads((written / "summary.json").read_text())
    assert summary["coarsest"][0]["bound_px"] == 0.1
    assert summary["coarsest"][0]["change"]["time_s"] == 1.0
    with pytest.raises(InputError, match="exists"):
        reporting.save(invented(), written, "command")


def test_the_table_names_the_settings_of_interest():
    """Rationale: it stands in the documentation as it is."""
    text = reporting.markdown(invented())
    assert text.count("| 0.8 mm |") == 3  # two bounds, and as shipped
    said = reporting.outcome(invented())
    assert "within 0.1 px" in said[0]
    assert "0.3 px" not in "".join(said)
    assert "15 s of flow in place of 4 s change 0.001 px and 0.01 µm" in said[-1]


def test_the_page_opens_anywhere(written, faults_of):
    """Rationale: four panels, and all settings below them."""
    assert faults_of(written / "report.html") == []
    html = (written / "report.html").read_text(encoding="utf-8")
    assert html.count("<img ") == 4
    assert html.count("<tr>") > len(invented().changes)


def test_a_study_in_which_nothing_suffices_is_drawn_too(tmp_path):
    """Rationale: a cylinder that is hotter than any before may need a finer mesh."""
    study = invented()
    few = replace(
        study, changes=tuple(replace(c, line_px=c.line_px + 1.0) for c in study.changes[:-1])
    )
    assert few.shipped is None
    assert [each.change for each in few.coarsest] == [None, None]
    reporting.save(few, tmp_path / "out", "command")
    assert reporting.outcome(few)[0] == "No coarser setting stays within 0.1 px of the finest."


def test_a_file_is_no_folder_for_results(tmp_path, monkeypatch):
    """Rationale: asked before minutes of simulation."""
    monkeypatch.chdir(tmp_path)
    status, _, err = command("field", "convergence", "-o", "convergence.png")
    assert status == 2
    assert "-o convergence.png: the results are a folder" in err
    assert not list(tmp_path.iterdir())
