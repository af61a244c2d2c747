"""Where methods fail: each trouble is made worse until a method fails; writes the chart's table.

python benchmarks/failures.py                     all of it: five minutes on two cores
python benchmarks/failures.py --panel fringes     the rows of a panel alone, among the others
python benchmarks/failures.py --only "grid too"   the rows whose trouble or method holds this, shown
"""

from __future__ import annotations

import argparse
import csv
import sys
from importlib import import_module, metadata
from typing import Any

from worsening import worsen

from virtual_sensor.files import written_whole
from virtual_sensor.records import write_csv
from virtual_sensor.studies.chart.failures import FILE, failures, table

PANELS = {
    "rays": "failing_rays",
    "frames": "failing_frames",
    "search": "failing_searches",
    "correction": "failing_corrections",
    "fringes": "failing_fringes",
    "camera": "failing_cameras",
    "bounces": "failing_bounces",
    "lines": "failing_lines",
}


def rows(only: str = "", panels: tuple[str, ...] = tuple(PANELS)) -> list[dict[str, Any]]:
    """Measure: the rows of the table, of some panels, with this in their trouble or method."""
    found = []
    for panel in panels:
        for case in import_module(PANELS[panel]).cases():
            if only in f"{panel}: {case.trouble}: {case.method}":
                print(f"{panel}: {case.trouble}: {case.method}", file=sys.stderr, flush=True)
                found.append({"panel": panel} | worsen(case))
    return found


def main() -> None:
    """Write the table, or show a part of it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default="", help="a part of 'panel: trouble: method'")
    parser.add_argument("--panel", choices=PANELS, help="of the chart, alone")
    asked = parser.parse_args()
    only, panels = asked.only, (asked.panel,) if asked.panel else tuple(PANELS)
    found = rows(only, panels)
    if only:
        writer = csv.DictWriter(sys.stdout, list(found[0]) if found else [])
        writer.writeheader()
        writer.writerows(found)
        return
    by_panel = {each: list(failures((each,)).rows()) for each in PANELS if each not in panels}
    by_panel |= {each: [row for row in found if row["panel"] == each] for each in panels}
    found = [row for each in PANELS for row in by_panel[each]]
    made = f"# virtual_sensor {metadata.version('virtual-sensor')}: python benchmarks/failures.py\n"
    with written_whole(FILE) as temporary:
        write_csv(temporary, table(found))
        temporary.write_text(made + temporary.read_text(encoding="utf-8"), encoding="utf-8")


if __name__ == "__main__":
    main()
