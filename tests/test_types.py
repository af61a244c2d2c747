"""The type checker sees the names that users and the house rely on, in the pages too."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
OTHERS = "from typing import Any\nimage: Any\ny_mm: Any\n"  # the reader's own

WRONG = """
import virtual_sensor as vs
from virtual_sensor_plugins import lit_pixls
from virtual_sensor_plugins.refractive import Refractiv
import virtual_sensor_plugins.refractivee
scene = vs.load_scene("hot_cylinder")
vs.renderr(scene)
vs.render(5)
vs.render(scene, samples=4)
vs.render_frame(scene).radiances
"""

pytestmark = pytest.mark.slow
pytest.importorskip("mypy", reason="comes with the extra 'dev'")


def checked(*files, but=()):
    """What mypy says of files, but for errors of some codes, line by line: (file, number, text)."""
    line = [sys.executable, "-m", "mypy", "--hide-error-context", "--no-error-summary"]
    line += [*(f"--disable-error-code={code}" for code in but), "--no-warn-unused-ignores"]
    ended = subprocess.run(
        [*line, *map(str, files)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert ended.stderr == ""
    said = (text.split(":", 2) for text in ended.stdout.splitlines())
    return [(Path(file).name, int(number), text.strip()) for file, number, text in said]


def test_a_misspelt_name_is_refused(tmp_path):
    """Rationale: where a checker takes a module for Any, it takes everything for right."""
    file = tmp_path / "wrong.py"
    file.write_text(WRONG)
    refused = {number for _, number, text in checked(file) if text.startswith("error")}
    assert refused == {3, 4, 5, *range(7, len(WRONG.splitlines()) + 1)}


def test_the_python_of_the_pages_uses_names_that_are_there(tmp_path):
    """Rationale: the reader copies it, and knows: this scene has air, lists give arrays."""
    files = []
    for page in PAGES:
        blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
        if blocks:
            name = "_".join(page.relative_to(ROOT).with_suffix("").parts).replace("-", "_")
            files.append(tmp_path / f"{name}.py")
            files[-1].write_text(OTHERS + "\n".join(blocks), encoding="utf-8")
    assert files
    assert checked(*files, but=("union-attr", "assignment", "misc")) == []
