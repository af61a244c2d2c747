"""The command `virtual-sensor`: arguments to studies, nothing else."""

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from virtual_sensor import engine
from virtual_sensor.errors import EngineError, InputError

app = typer.Typer(
    help="A virtual laser-triangulation sensor that sees through hot air.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)
console = Console()

SceneArgument = Annotated[
    str, typer.Argument(metavar="SCENE", help="A scene file, or the name of one that comes along.")
]
Definitions = Annotated[
    list[str] | None,
    typer.Option("-D", metavar="NAME=VALUE", help="Set a parameter of the scene; repeatable."),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace results that exist.")]


@app.callback()
def choose_engine(
    variant: Annotated[
        str | None,
        typer.Option(help="Mitsuba variant, such as llvm_ad_mono (default) or cuda_ad_mono."),
    ] = None,
) -> None:
    """Options before the command."""
    if variant:
        engine.activate(variant)


@app.command(
    epilog="Examples:\n\n"
    "    virtual-sensor measure hot_cylinder\n\n"
    "    virtual-sensor measure hot_cylinder -D beta=15 -D line_radius=0.1 -o turned\n\n"
    "    virtual-sensor measure stepped_shaft -o shaft"
)
def measure(
    scene: SceneArgument,
    define: Definitions = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")] = Path(
        "measured"
    ),
    overwrite: Overwrite = False,
) -> None:
    """Measure a part cold and hot: frames, line centres, points, ray search and a picture page."""
    from virtual_sensor.imaging.scene import load_scene
    from virtual_sensor.studies.measure import measure as run
    from virtual_sensor.studies.measure import summary
    from virtual_sensor.studies.results import save

    _refuse_existing(output, overwrite)
    with _progress() as bar:
        task = bar.add_task("loading the scene", total=1.0)

        def report(stage: str, fraction: float) -> None:
            bar.update(task, description=stage, completed=0.9 * fraction)

        result = run(load_scene(scene, **_definitions(define)), report)
        bar.update(task, description="writing the results", completed=0.92)
        save(result, output, overwrite)
        bar.update(task, description="done", completed=1.0)
    figures = summary(result)
    table = Table("", "rendered - search, px rms", "at most", "line centres", "rendered in")
    for name, state in result.states.items():
        agreement = state.agreement
        table.add_row(
            name,
            f"{agreement.rms_px:.4f}",
            f"{agreement.largest_px:.4f}",
            str(figures["states"][name]["line"]["ok"]),
            f"{state.seconds['render']:.1f} s",
        )
    console.print(table)
    for name, value in figures["nine_rays_um"].items():
        if value is not None:
            console.print(f"  nine rays, {name}: {value:.3g} µm", highlight=False)
    for text in result.told:
        console.print(f"Note: {text}", style="yellow", highlight=False)
    console.print(
        f"{result.seconds:.1f} s; results in {output}, look at {output / 'report.png'} first",
        highlight=False,
        soft_wrap=True,
    )


@app.command(
    epilog="Examples:\n\n"
    "    virtual-sensor search hot_cylinder\n\n"
    "    virtual-sensor search hot_cylinder --method newton -y 0 -y -5 -D beta=30\n\n"
    "    virtual-sensor search hot_cylinder --rays 401 -o line.csv"
)
def search(
    scene: SceneArgument,
    define: Definitions = None,
    method: Annotated[str, typer.Option(help="paper or newton.")] = "paper",
    y: Annotated[
        list[float] | None,
        typer.Option("-y", help="A ray's position along the line, mm; repeatable."),
    ] = None,
    rays: Annotated[
        int | None, typer.Option(min=1, help="So many rays along the whole line instead.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="CSV file for the result.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Search, ray by ray, for the pixels that see the laser: no image is made.

    Without -y or --rays: the paper's nine rays, y = 0 to -10 mm.
    """
    from virtual_sensor.imaging.scene import load_scene
    from virtual_sensor.studies.search import search as run
    from virtual_sensor.studies.tables import write_csv

    if method not in ("paper", "newton"):
        raise InputError(f"--method {method}: choose paper or newton")
    if output:
        _refuse_existing(output, overwrite)
    columns = run(load_scene(scene, **_definitions(define)), method, y, rays)
    if output:
        write_csv(output, columns)
        console.print(f"{len(columns['y_mm'])} rays in {output}", highlight=False)
        return
    shown = Table("y, mm", "u, px", "v, px", "distance, µm", "marches", "status")
    for row in zip(
        *(columns[k] for k in ("y_mm", "pixel_u", "pixel_v", "distance_um", "marches", "status")),
        strict=True,
    ):
        shown.add_row(*(f"{v:.4f}" if isinstance(v, float) else str(v) for v in row))
    console.print(shown)


@app.command()
def doctor() -> None:
    """Tell in plain words what this machine computes with, and what to install if it can't."""
    from virtual_sensor.studies.doctor import diagnose, report

    diagnosis = diagnose()
    console.print(report(diagnosis), highlight=False, markup=False, soft_wrap=True)
    raise typer.Exit(0 if diagnosis.ok else 1)


def _definitions(define: list[str] | None) -> dict[str, str]:
    pairs = {}
    for text in define or []:
        name, equals, value = text.partition("=")
        if not (name and equals):
            raise InputError(f"-D {text}: write it as NAME=VALUE, such as -D beta=15")
        pairs[name] = value
    return pairs


def _refuse_existing(path: Path, overwrite: bool) -> None:
    """Before any work is done."""
    if path.exists() and not overwrite:
        raise InputError(f"{path} exists; name another with -o, or say --overwrite")


def _progress() -> Progress:
    columns = (
        TextColumn("{task.description:<36}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
    )
    return Progress(*columns, console=console, transient=not console.is_terminal)


def main() -> None:
    """Run the command; a user's errors are told in a line, without a traceback."""
    try:
        app()
    except (InputError, EngineError) as error:
        Console(stderr=True).print(f"Error: {error}", style="red", highlight=False, soft_wrap=True)
        sys.exit(2)
