"""Several cameras and lasers, measured pair by pair by one command."""

import json
from types import SimpleNamespace

import numpy as np
from command_line import command
from several import two_by_two

from virtual_sensor.imaging.checks import FACETS_LIE
from virtual_sensor.reporting.pairs import pair_notes


def test_each_pair_has_a_folder_and_the_page_leads_to_all(tmp_path, monkeypatch, unpainted_test):
    """Rationale: `new --alpha 30 --alpha -30` is followed by `measure`, which asked for names."""
    monkeypatch.chdir(tmp_path)
    two_by_two(tmp_path, "cold_cylinder")
    small = [f"-D{each}" for each in ("width=128", "height=128", "line_radius=0.5", "spp=4")]
    status, said, _ = command("measure", "two_cold_cylinder", *small, "-o", "out")
    assert status == 0
    pairs = {f"{camera}_{laser}" for camera in ("near", "far") for laser in ("red", "blue")}
    figures = json.loads((tmp_path / "out/summary.json").read_text(encoding="utf-8"))
    assert set(figures["pairs"]) == pairs
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    points = tmp_path / "out/points_cold.ply"
    joined = points.read_bytes()
    head, _, body = joined.partition(b"end_header\n")
    assert b"property int pair" in head
    rows = np.frombuffer(body, [*((name, "<f4") for name in "xyzi"), ("pair", "<i4")])
    for number, name in enumerate(figures["pairs"], start=1):
        _, _, own = (tmp_path / "out" / name / points.name).read_bytes().partition(b"end_header\n")
        alone = np.frombuffer(own, "<f4").reshape(-1, 4)
        there = rows[rows["pair"] == number]
        assert len(alone) > 0
        np.testing.assert_array_equal(np.stack([there[each] for each in "xyzi"], axis=1), alone)
    assert "The points that each pair measures in cold air" in page
    for name in pairs:
        own = json.loads((tmp_path / "out" / name / "summary.json").read_text(encoding="utf-8"))
        assert own == figures["pairs"][name]
        assert f'href="{name}/report.html"' in page
        assert name in said


def test_what_facets_cost_is_said_of_one_pair():
    """Each pair sees them at another angle, so that in pixels their notes differ."""
    notes = {name: (f"{FACETS_LIE} up to {name} px", f"dark {name}") for name in ("1", "2")}
    made = SimpleNamespace(pairs={n: SimpleNamespace(notes=each) for n, each in notes.items()})
    said = [*pair_notes(made)]
    assert said == [f"1: {FACETS_LIE} up to 1 px", "1: dark 1", "2: dark 2"]
