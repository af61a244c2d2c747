"""Put results into the README and the pages beside this file, those that are given.

``python docs/update_readme.py --measured DIR --converged DIR --reproduced DIR
--charted DIR --peers DIR --tried DIR``
"""

import argparse
import shutil
from pathlib import Path

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
        replace("<!-- table: measure -->\n", measured / "table.md")
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
        for panel in ("rays", "frames", "search", "lines"):  # that can be read on a phone
            shutil.copy(charted / f"{panel}.png", PICTURES / f"speed_accuracy_{panel}.png")
    if peers:
        replace(
            "<!-- table: peers -->\n", peers / "peers.md", HERE / "explanation/speed_accuracy.md"
        )
    if tried:
        replace("<!-- table: trial -->\n", tried / "table.md", HERE / "explanation/detectors.md")
        shutil.copy(tried / "signal.png", PICTURES / "trial_signal.png")


def replace(begin: str, table: Path, page: Path = README) -> None:
    """Put a table, without the heading that it has as a page, between its mark and the next end."""
    before, rest = page.read_text(encoding="utf-8").split(begin)
    _, after = rest.split(END, maxsplit=1)
    lines = table.read_text(encoding="utf-8").splitlines()
    text = "\n".join(line for line in lines if not line.startswith("# ")).strip()
    page.write_text(f"{before}{begin}\n{text}\n\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("measured", "converged", "reproduced", "charted", "peers", "tried"):
        parser.add_argument(f"--{name}", type=Path)
    main(**vars(parser.parse_args()))
