"""Put results into the README and the pages beside this file, those that are given.

``python docs/update_readme.py --measured DIR --converged DIR --reproduced DIR
--charted DIR --peers DIR --tried DIR``
"""

import argparse
import json
import shutil
from pathlib import Path
from typing import Any

from virtual_sensor.metrology.centres import FOUND_NAMES
from virtual_sensor.reporting.chart import TITLES

HERE = Path(__file__).parent
PICTURES = HERE / "pictures"
README = HERE.parent / "README.md"
END = "<!-- end of table -->"


def main(
    measured: Path | None,
    converged: Path | None,
    reproduced: Path | None,
    charted: Path | None,
    peers: Path | None,
    tried: Path | None,
) -> None:
    """Replace what stands between the marks, and the pictures."""
    if measured:
        replace("<!-- table: measure -->\n", measured / "table.md", HERE / "explanation/method.md")
        five_lines(json.loads((measured / "summary.json").read_text(encoding="utf-8")))
        shutil.copy(measured / "report.png", PICTURES / "hot_cylinder.png")
    if converged:
        replace(
            "<!-- table: field convergence -->\n",
            converged / "convergence.md",
            HERE / "how_to/own_air.md",
        )
        shutil.copy(converged / "convergence.png", PICTURES / "convergence.png")
    if reproduced:
        report = reproduced / "report"
        replace(
            "<!-- table: statements -->\n",
            report / "statements.md",
            HERE / "explanation/reproduction.md",
        )
        shutil.copy(report / "figure_7.png", PICTURES / "figure_7.png")
    if charted:
        replace(
            "<!-- table: chart -->\n", charted / "front.md", HERE / "explanation/speed_accuracy.md"
        )
        shutil.copy(charted / "chart.png", PICTURES / "speed_accuracy.png")
        # Each panel alone can be read on a phone.
        for panel in TITLES:
            shutil.copy(charted / f"{panel}.png", PICTURES / f"speed_accuracy_{panel}.png")
    if peers:
        replace(
            "<!-- table: peers -->\n", peers / "peers.md", HERE / "explanation/speed_accuracy.md"
        )
    if tried:
        replace("<!-- table: trial -->\n", tried / "table.md", HERE / "explanation/detectors.md")
        shutil.copy(tried / "signal.png", PICTURES / "trial_signal.png")


def five_lines(summary: dict[str, Any]) -> None:
    """Put the README's table of accuracy and speed together."""
    states = [summary["states"][name] for name in ("cold", "hot")]
    width, height = (summary["parameters"][name] for name in ("width", "height"))
    rays = sum(states[0]["search_status"].values()) + 2 * summary["probe_rays"]["rays"]
    lines = {
        "Measured minus true section, rms": [f"{s['section']['rms_um']:.3g} µm" for s in states],
        "Rendered line minus ray search, rms": [
            f"{s['line_minus_search']['rms_px']:.4f} px" for s in states
        ],
        "Centres that are ok and wrong by the frame's truth": [
            f"{s['line_minus_truth']['wrong']} of {sum(s['line_status'][n] for n in FOUND_NAMES)}"
            for s in states
        ],
        f"Frame of {width} x {height} px, {summary['made_with']['samples_per_pixel']} samples per"
        " pixel": [f"{s['render_time_s']:.2f} s" for s in states],
        f"Search of {rays} rays by Newton's method": [
            f"{s['search_time_s']:.2f} s" for s in states
        ],
    }
    rows = [f"| {words} | {' | '.join(values)} |" for words, values in lines.items()]
    head = ["| `virtual-sensor measure hot_cylinder` | cold | hot |", "| --- | --- | --- |"]
    put("<!-- table: measure in five lines -->\n", "\n".join(head + rows), README)


def replace(begin: str, table: Path, page: Path) -> None:
    """Put a table, without the heading that it has as a page, between its mark and the next end."""
    lines = table.read_text(encoding="utf-8").splitlines()
    put(begin, "\n".join(line for line in lines if not line.startswith("# ")).strip(), page)


def put(begin: str, text: str, page: Path) -> None:
    """Put a text between its mark and the next end."""
    before, rest = page.read_text(encoding="utf-8").split(begin)
    _, after = rest.split(END, maxsplit=1)
    page.write_text(f"{before}{begin}\n{text}\n\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("measured", "converged", "reproduced", "charted", "peers", "tried"):
        parser.add_argument(f"--{name}", type=Path)
    main(**vars(parser.parse_args()))
