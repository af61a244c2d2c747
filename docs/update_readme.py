"""Put results into the README: ``python docs/update_readme.py measured fineness``."""

import shutil
import sys
from pathlib import Path

HERE = Path(__file__).parent
END = "<!-- end of table -->"


def main(measured: Path, fineness: Path) -> None:
    """Replace what stands between the README's marks, and the pictures."""
    replace("<!-- table: measure -->\n", measured / "table.md")
    replace("<!-- table: field fineness -->\n", fineness / "fineness.md")
    shutil.copy(measured / "report.png", HERE / "hot_cylinder.png")
    shutil.copy(fineness / "fineness.png", HERE / "fineness.png")


def replace(begin: str, table: Path) -> None:
    """Put a table between its mark and the next end."""
    readme = HERE.parent / "README.md"
    before, rest = readme.read_text(encoding="utf-8").split(begin)
    _, after = rest.split(END, maxsplit=1)
    text = table.read_text(encoding="utf-8")
    readme.write_text(f"{before}{begin}\n{text}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
