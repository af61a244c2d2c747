"""Run a page's blocks of commands and of Python in an empty folder, and show what they print.

``python docs/refresh_outputs.py docs/tutorial.md [--all] [--folder DIR]``

The block of ``text`` that follows a block is replaced by what it printed, without progress; a
picture ``PAGE_RESULTS.png`` by that of the folder of results. Blocks marked ``not run`` are left
alone, unless ``--all`` is said, and what needs another machine's installation is never run.
"""

import argparse
import contextlib
import io
import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from virtual_sensor.files import written_whole

FENCE = re.compile(
    r"^(?P<mark><!-- not run: [^\n]+? -->\n)?```(?P<language>sh|python)\n(?P<code>.*?)^```\n"
    r"(?P<shown>\n```text\n.*?^```\n)?",
    re.M | re.S,
)
PROGRESS = re.compile(r"^ *\d+% after .*\n", re.M)
PICTURE = re.compile(r"!\[[^\]]*\]\((?P<path>[^)]+\.png)\)")


def refresh(page: Path, folder: Path, everything: bool) -> None:
    """Run the page's blocks in `folder`, and write what they print into it."""
    names: dict[str, Any] = {}

    def replaced(found: re.Match[str]) -> str:
        if found["mark"] and (not everything or "installation" in found["mark"]):
            return found[0]
        printed = printed_by(found["language"], found["code"], folder, names).rstrip()
        code = f"{found['mark'] or ''}```{found['language']}\n{found['code']}```\n"
        return code + (f"\n```text\n{printed}\n```\n" if found["shown"] else "")

    text = FENCE.sub(replaced, page.read_text(encoding="utf-8"))
    for picture in PICTURE.finditer(text):
        results = Path(picture["path"]).stem.removeprefix(f"{page.stem}_")
        if (made := folder / results / "report.png").is_file():
            shutil.copy(made, page.parent / picture["path"])
    with written_whole(page) as temporary:
        temporary.write_text(text, encoding="utf-8")


def printed_by(language: str, code: str, folder: Path, names: dict[str, Any]) -> str:
    """What a block prints; it ends the program if it fails."""
    print(code, end="", flush=True)
    if language == "sh":
        wide = os.environ | {"COLUMNS": "100"}
        ran = subprocess.run(
            ["bash", "-ec", code], cwd=folder, env=wide, text=True, check=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        return PROGRESS.sub("", ran.stdout)
    printed = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(printed):
        exec(compile(code, "page", "exec"), names)
    return printed.getvalue()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("page", type=Path)
    parser.add_argument("--all", action="store_true", help="also blocks marked `not run`")
    parser.add_argument("--folder", type=Path, help="in which they run; by default one that is new")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        refresh(given.page, given.folder or Path(temporary), given.all)
