"""Put results into the README, those that are given.

``python docs/update_readme.py --measured DIR --fineness DIR --reproduced DIR
--charted DIR``
"""

import argparse
import shutil
from pathlib import Path

HERE = Path(__file__).parent
END = "<!-- end of table -->"


def main(
    measured: Path | None,
    fineness: Path | None,
    reproduced: Path | None,
    charted: Path | None,
) -> None:
    """Replace what stands between the README's marks, and the pictures."""
    if measured:
        replace("<!-- table: measure -->\n", measured / "table.md")
        shutil.copy(measured / "report.png", HERE / "hot_cylinder.png")
    if fineness:
        replace("<!-- table: field fineness -->\n", fineness / "fineness.md")
        shutil.copy(fineness / "fineness.png", HERE / "fineness.png")
    if reproduced:
        report = reproduced / "report"
        replace("<!-- table: statements -->\n", report / "statements.md")
        shutil.copy(report / "figure_7_widened.png", HERE / "figure_7.png")
    if charted:
        replace("<!-- table: chart -->\n", charted / "front.md")
        shutil.copy(charted / "chart.png", HERE / "speed_accuracy.png")


def replace(begin: str, table: Path) -> None:
    """Put a table between its mark and the next end."""
    readme = HERE.parent / "README.md"
    before, rest = readme.read_text(encoding="utf-8").split(begin)
    _, after = rest.split(END, maxsplit=1)
    text = table.read_text(encoding="utf-8")
    readme.write_text(f"{before}{begin}\n{text}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("measured", "fineness", "reproduced", "charted"):
        parser.add_argument(f"--{name}", type=Path)
    main(**vars(parser.parse_args()))
