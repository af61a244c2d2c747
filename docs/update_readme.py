"""Put a measurement into the README: ``python docs/update_readme.py measured``."""

import shutil
import sys
from pathlib import Path

HERE = Path(__file__).parent
BEGIN, END = "<!-- table: docs/update_readme.py -->\n", "<!-- end of table -->"


def main(results: Path) -> None:
    """Replace what stands between the README's two marks, and the picture."""
    readme = HERE.parent / "README.md"
    before, rest = readme.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END)[1]
    table = (results / "table.md").read_text(encoding="utf-8")
    readme.write_text(f"{before}{BEGIN}\n{table}\n{END}{after}", encoding="utf-8")
    shutil.copy(results / "report.png", HERE / "hot_cylinder.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
