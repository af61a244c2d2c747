"""Options that the command `fringes` and the words beside it share."""

from typing import Annotated

import typer

from virtual_sensor.cli import shared

Scene = Annotated[
    str,
    typer.Argument(
        metavar="SCENE",
        callback=shared.there,
        help="A scene file with a projector, or one that is installed: fringe_cylinder,"
        " fringe_stepped_shaft.",
    ),
]
Projector = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Of the scene's projectors, where it has several: its id in the file.",
    ),
]
Samples = Annotated[
    int | None, typer.Option(min=1, help="Samples per pixel; by default the scene's own.")
]
