"""Folders of results, and what is in them."""

from virtual_sensor.files import RESULTS_SIGN

WRITE_AND_WAIT = """
import signal, sys
from pathlib import Path
from virtual_sensor.files import folder_written_whole
with folder_written_whole(Path(sys.argv[1]), overwrite=True) as folder:
    (folder / "summary.json").write_text("half")
    print("writing", flush=True)
    signal.pause()
"""


def earlier_results(tmp_path):
    """A folder of earlier results."""
    folder = tmp_path / "measured"
    folder.mkdir()
    (folder / RESULTS_SIGN).write_text("earlier")
    return folder


def contents(folder):
    """Files below a folder, hidden ones too, with what is in them."""
    files = (p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): p.read_bytes() for p in files}
