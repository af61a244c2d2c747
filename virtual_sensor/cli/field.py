"""The commands `virtual-sensor field ...`."""

import typer

app = typer.Typer(
    help="The air's field: simulate it, import it from another solver, look at it.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)


@app.callback()
def field() -> None:
    """The air's field: simulate it, import it from another solver, look at it."""
