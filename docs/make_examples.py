"""Write the pages of ``examples``, run as they are: ``python docs/make_examples.py [NAME ...]``.

Each script of ``examples/`` is a page: its text, its code, what that prints, and its picture, which
has the script's name.
"""

import contextlib
import io
import sys
import tempfile
from pathlib import Path

import jupytext
import matplotlib
import matplotlib.pyplot as plt
from PIL import Image

ROOT = Path(__file__).parents[1]
SCRIPTS = ROOT / "examples"
PAGES = ROOT / "docs" / "examples"
PICTURES = ROOT / "docs" / "pictures" / "examples"
LARGEST_BYTES = 60_000

ORDER = (
    "own_part",
    "shiny_metal",
    "two_cameras",
    "camera",
    "scan",
    "own_detector",
    "training_images",
    "correct_profile",
    "two_poses",
    "fringes",
    "own_field",
    "dask_sweep",
)


def cells(name: str) -> list[tuple[str, str]]:
    """Kind, "markdown" or "code", and text of each cell of a script."""
    text = (SCRIPTS / f"{name}.py").read_text(encoding="utf-8")
    return [(each.cell_type, each.source) for each in jupytext.reads(text, "py:percent").cells]


def title(name: str) -> str:
    """The heading of a script."""
    return cells(name)[0][1].splitlines()[0].removeprefix("# ")


def summary(name: str) -> str:
    """The first paragraph below the heading."""
    return " ".join(cells(name)[0][1].split("\n\n")[1].splitlines())


def page(name: str, printed: list[str]) -> str:
    """The page of a script, with what its cells printed."""
    shown = cells(name)
    last = max(i for i, (kind, _) in enumerate(shown) if kind == "code")
    blocks = []
    for number, (kind, text) in enumerate(shown):
        blocks.append(f"```python\n{text}\n```" if kind == "code" else text)
        if printed[number]:
            blocks.append(f"```text\n{printed[number].rstrip()}\n```")
        if number == last:
            blocks.append(f"![{title(name)}](../pictures/examples/{name}.png)")
    blocks.append(
        f"The script is `examples/{name}.py` of the repository; `jupytext --to ipynb {name}.py`"
        " makes a notebook of it."
    )
    return "\n\n".join(blocks) + "\n"


def run(name: str) -> list[str]:
    """Run a script in an empty folder, keep its picture, and give what each cell prints."""
    printed, names = [], {"__name__": "__main__"}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for kind, text in cells(name):
            with contextlib.redirect_stdout(io.StringIO()) as out:
                if kind == "code":
                    exec(compile(text, f"{name}.py", "exec"), names)
            printed.append(out.getvalue())
        plt.close("all")
        picture = Image.open(f"{name}.png").convert("RGB")
    save_small(picture, PICTURES / f"{name}.png")
    return printed


def save_small(picture: Image.Image, path: Path) -> None:
    """Write a picture with as many colours, and then pixels, as its file may have."""
    path.parent.mkdir(parents=True, exist_ok=True)
    width, height = picture.size
    for scale in (1.0, 0.85, 0.7):
        scaled = picture.resize((round(width * scale), round(height * scale)), Image.LANCZOS)
        for colours in (256, 64, 32, 16):
            method = Image.Quantize.FASTOCTREE  # rare colours stay
            scaled.quantize(colours, method, dither=Image.Dither.NONE).save(path, optimize=True)
            if path.stat().st_size < LARGEST_BYTES:
                return
    raise SystemExit(f"{path}: over {LARGEST_BYTES} bytes; make the script's figure smaller")


def index() -> str:
    """The page of all examples, with their pictures."""
    rows = [
        f'| <img src="../pictures/examples/{name}.png" width="260" style="min-width: 8em"'
        f' alt="{title(name)}">'
        f" | **[{title(name)}]({name}.md)**<br>{summary(name)} |"
        for name in ORDER
    ]
    return "\n".join(
        [
            "# Examples\n",
            "Twelve short scripts. They run as they are, in an empty folder; `jupytext --to ipynb`"
            " makes notebooks of them.\n",
            "| Picture | Example |",
            "|---|---|",
            *rows,
            "",
        ]
    )


def main(names: list[str]) -> None:
    """Run the scripts and write their pages, and that of all."""
    matplotlib.use("Agg")
    PAGES.mkdir(parents=True, exist_ok=True)
    for name in names or ORDER:
        print(name)
        (PAGES / f"{name}.md").write_text(page(name, run(name)), encoding="utf-8")
    (PAGES / "index.md").write_text(index(), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
