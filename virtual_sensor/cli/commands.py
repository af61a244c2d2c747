"""The command `virtual-sensor`: arguments to studies, nothing else."""

from importlib import metadata
from typing import Annotated, Any

import typer

from virtual_sensor import engine, interrupts
from virtual_sensor.cli import (
    burst,
    chart,
    correct,
    detect,
    doctor,
    fringes,
    measure,
    new,
    reproduce,
    search,
    simulation,
    sweep,
    trial,
)
from virtual_sensor.cli.console import errors, one_line, streams
from virtual_sensor.cli.shared import NOTHING_FOUND, console
from virtual_sensor.errors import EngineError, InputError, Interrupted, NothingFoundError

app = typer.Typer(
    help="A virtual laser-triangulation sensor that sees through hot air.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)

_CommandLineError: Any = typer.BadParameter.__base__
_HELP_WIDTH = 72
"""Characters that the help needs to be written in boxes."""

app.add_typer(simulation.app, name="field")  # with the commands of field.py
app.add_typer(fringes.app, name="fringes")


def _tell_version(asked: bool) -> None:
    if asked:
        console.print(f"virtual-sensor {metadata.version('virtual-sensor')}")
        raise typer.Exit


@app.callback(epilog="Start with:\n\n    virtual-sensor measure hot_cylinder")
def before_the_command(
    variant: Annotated[
        str | None,
        typer.Option(help="Mitsuba variant, such as llvm_ad_mono (default) or cuda_ad_mono."),
    ] = None,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_tell_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    """Options before the command."""
    if variant:
        engine.activate(variant)


app.command(epilog=new.EPILOG)(new.new)
app.command(epilog=measure.EPILOG)(measure.measure)
app.command(epilog=search.EPILOG)(search.search)
app.command(epilog=correct.EPILOG)(correct.correct)
app.command(epilog=burst.EPILOG)(burst.burst)
app.command(epilog=sweep.EPILOG)(sweep.sweep)
app.command(epilog=reproduce.EPILOG)(reproduce.reproduce)
app.command(epilog=chart.EPILOG)(chart.chart)
app.command(epilog=detect.EPILOG)(detect.detect)
app.command(epilog=trial.EPILOG)(trial.trial)
app.command(epilog=doctor.EPILOG)(doctor.doctor)


def run() -> int:
    """Run the command and give its exit status; an error or a stop is printed in one line."""
    with streams() as faults:
        status = _run()
    if faults:
        errors.print(
            f"Error: standard output: can't be written ({faults[0].strerror}); results in files are"
            " complete"
        )
    return status or (1 if faults else 0)


def _run() -> int:
    try:
        command: Any = typer.main.get_command(app)
        if console.width < _HELP_WIDTH:
            _plainly(command)
        return command(prog_name="virtual-sensor", standalone_mode=False) or 0
    except _CommandLineError as error:
        return _refused(error)
    except BaseException as error:
        status = interrupts.exit_status(error)
        if status is None and not isinstance(error, (InputError, EngineError)):
            raise
        if status is None:
            # One line for a user's slip, whatever the names in it.
            text = str(error) if isinstance(error, EngineError) else one_line(_with_names(error))
            errors.print(f"Error: {text}", style="red")
            return NOTHING_FOUND if isinstance(error, NothingFoundError) else 2
        text = f"{error}" if isinstance(error, Interrupted) else interrupts.line(status)
        errors.print(text, style="yellow")
        return status


def _with_names(error: BaseException) -> str:
    from virtual_sensor.imaging.scene_file import with_names  # few commands fail

    return with_names(f"{error}")


def _plainly(command: Any) -> None:
    """Have a command's help, and that of those below it, written without boxes, which cut words."""
    command.rich_markup_mode = None
    for each in getattr(command, "commands", {}).values():
        _plainly(each)


def _refused(error: Any) -> int:
    """Say in a line what is wrong with the command line."""
    said = error.format_message()
    if type(error).__name__ == "NoArgsIsHelpError":
        console.print(said, end="")  # the help, if it is not printed yet
    else:
        asked = error.ctx.command_path if error.ctx else "virtual-sensor"
        text = f"Error: {one_line(said).rstrip('.')}; see `{asked} --help`"
        errors.print(text, style="red")
    return int(error.exit_code)
