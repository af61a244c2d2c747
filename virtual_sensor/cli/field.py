"""The commands `virtual-sensor field ...`."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from virtual_sensor.cli.shared import (
    Definitions,
    Overwrite,
    console,
    definitions,
    progress,
)
from virtual_sensor.files import check_output, written_whole

app = typer.Typer(
    help="The air's field: simulate it, import it from another solver, look at it.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)


@app.callback()
def field() -> None:
    """The air's field: simulate it, import it from another solver, look at it."""


@app.command(
    epilog="Examples:\n\n"
    "    virtual-sensor field info air.nc\n\n"
    "    virtual-sensor field info air.nc --scene hot_cylinder -D beta=30 -o air.png\n\n"
    "    virtual-sensor field info swaying.nc --time 2.5 --json air.json"
)
def info(
    field: Annotated[Path, typer.Argument(metavar="FIELD", help="A field file, NetCDF.")],
    scene: Annotated[
        str | None,
        typer.Option(
            help="Scene whose light goes through it: a file, or one that comes along. By default "
            "hot_cylinder, left out where it does not suit."
        ),
    ] = None,
    define: Definitions = None,
    time: Annotated[
        float | None, typer.Option(help="Flow time, s, of a field with many; by default the last.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="PNG of three cuts with the light's ways.")
    ] = None,
    figures: Annotated[
        Path | None, typer.Option("--json", help="File for all that is told, for programs.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Tell what a field holds, what it does to light, and whether border and grid are sound."""
    from virtual_sensor.studies import field_words
    from virtual_sensor.studies.field_info import field_info
    from virtual_sensor.studies.field_picture import draw_field

    for path in (output, figures):
        if path:
            check_output(path, overwrite)
    with progress() as bar:
        task = bar.add_task("reading the field", total=1.0)

        def report(stage: str, fraction: float) -> None:
            bar.update(task, description=stage, completed=fraction)

        told = field_info(field, scene, definitions(define), time, report)
        if output:
            report("drawing the picture", 0.8)
            draw_field(told, output)
        if figures:
            with written_whole(figures) as temporary:
                text = json.dumps(field_words.figures(told), indent=2, allow_nan=False)
                temporary.write_text(text + "\n", encoding="utf-8")
        report("done", 1.0)
    facts = Table.grid(padding=(0, 2))
    for name, words in field_words.facts(told).items():
        facts.add_row(name, words)
    console.print(facts)
    for headings, rows in field_words.tables(told):
        table = Table(*headings)
        for row in rows:
            table.add_row(*row)
        console.print(table)
    for text in field_words.verdicts(told):
        console.print(text, soft_wrap=True)
    for text in told.left_out:
        console.print(f"Left out: {text}", style="yellow", soft_wrap=True)
    if output:
        console.print(f"picture in {output}", soft_wrap=True)
