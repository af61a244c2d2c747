"""Several cameras and lasers, measured pair by pair by one command."""

import json

from command_line import command
from several import two_by_two


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
    for name in pairs:
        own = json.loads((tmp_path / "out" / name / "summary.json").read_text(encoding="utf-8"))
        assert own == figures["pairs"][name]
        assert f'href="{name}/report.html"' in page
        assert name in said
