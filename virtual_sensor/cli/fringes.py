"""The command `virtual-sensor fringes`, which takes a scene, and the words beside it.

Further words (`fringes decode`, `fringes calibrate`, `fringes poses`) are commands of `app`.
"""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from virtual_sensor.cli import fringe_calibrate, fringe_decode, fringe_options, fringe_poses, shared
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.fringe_recording import FringeRecording

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor fringes fringe_cylinder\n\n"
    "    virtual-sensor fringes fringe_cylinder -D beta=15 -D temperature=900 -o turned\n\n"
    "    virtual-sensor fringes fringe_cylinder --cold --codec 'phase 8 16,128,1280 u' --frames\n\n"
    "    virtual-sensor fringes fringe_cylinder --electrons 8000 --bits 10 --seed 1 -o noisy\n\n"
    "    virtual-sensor fringes fringe_cylinder --sensor-model cmos_5um5 --seed 1 -o recorded\n\n"
    "    virtual-sensor fringes fringe_cylinder -D pixels=false --electrons 8000 --tolerance 0.05"
)


class SceneOrWord(TyperGroup):
    """A command that takes a scene, and words that stand in the scene's place.

    A scene whose name is one of the words is given by its path: ./decode.xml.
    """

    allow_extra_args = False
    allow_interspersed_args = True

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Take the words as they are, else the options of the command itself."""
        if args and args[0] in self.commands:
            ctx.args = args
            return args
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the word's command, or the command itself."""
        if not ctx.args:
            return super().invoke(ctx)
        name, *args = ctx.args
        word, title = self.commands[name], f"{ctx.info_name} {name}"
        # Beside this command, not below it: its usage names the scene once.
        with ctx, word.make_context(title, args, parent=ctx.parent) as beside:
            return beside.command.invoke(beside)


app = typer.Typer(
    cls=SceneOrWord,
    invoke_without_command=True,
    subcommand_metavar="",
    rich_markup_mode="markdown",
)

CODEC = "phase 4"
Codec = Annotated[
    str,
    typer.Option(
        help="Patterns: `phase STEPS [PERIOD,PERIOD,...] [uv|u|v]`, periods in projector px, by"
        " default 16 px and each next one 8 times as long; or `gray [uv|u|v]`."
    ),
]


@app.callback(epilog=EPILOG)
@shared.with_options
def fringes(
    scene: fringe_options.Scene,
    define: shared.Definitions = None,
    camera: shared.Camera = None,
    source: fringe_options.Projector = None,
    codec: Codec = CODEC,
    cold: Annotated[
        bool, typer.Option("--cold", help="Measure the cold part alone.", show_default=False)
    ] = False,
    medium: Annotated[
        Path | None,
        typer.Option(
            help="Field of the air through which points are found; by default the scene's own."
        ),
    ] = None,
    spp: fringe_options.Samples = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            metavar="PX",
            help="Error of decoded columns and rows, px of the projector, rms, that is allowed:"
            " steps, periods and samples that keep it in the fewest images are chosen, and printed,"
            " in place of --codec and --spp.",
        ),
    ] = None,
    frames: Annotated[
        bool, typer.Option("--frames", help="Write all frames too, as PNG.", show_default=False)
    ] = False,
    output: shared.Folder = Path("fringes"),
    overwrite: shared.Overwrite = False,
    *,
    recording: FringeRecording,
) -> None:
    """Measure a part's whole surface by projected fringes: first cold, then hot.

    Exit status 3: there are results, but no pixel has a phase; the statuses say why.
    """
    from virtual_sensor.imaging.scene import load_scene
    from virtual_sensor.reporting.fringes import on_console, save
    from virtual_sensor.studies.fringes.measure import Settings, measure_fringes

    shared.check_folder(output, overwrite)
    if tolerance is not None and (codec != CODEC or spp is not None):
        raise InputError("--tolerance chooses codec and samples; leave out --codec and --spp")
    settings = Settings(codec, spp, recording, medium, cold, frames)
    with shared.reporting("loading the scene") as report:
        loaded = load_scene(scene, **shared.definitions(define)).only(camera, source)
        if tolerance is not None:
            from virtual_sensor.studies.fringes.tolerance import choose_fringes

            report("choosing the settings", 0.0)
            chosen = choose_fringes(
                loaded.only(None, loaded.projector_name), tolerance, recording=recording
            )
            settings = replace(settings, codec=chosen.codec, spp=chosen.spp)
            shared.console.print(f"{tolerance:g} px: {chosen}")
            shared.console.print(f"  because {'; '.join(chosen.why)}")
        result = measure_fringes(
            loaded, settings, lambda stage, fraction: report(stage, 0.9 * fraction)
        )
        report("writing the results", 0.92)
        save(result, output, shared.command_line(), overwrite, frames=frames)
    summary = result.summary
    shared.print_notes(summary.caveats)
    others = [note for note in summary.notes if note not in summary.caveats]
    shared.print_results(on_console(summary), others)
    shared.print_end(output)
    if not any(state.decoded.pixels for state in summary.states.values()):
        raise typer.Exit(shared.NOTHING_FOUND)


app.command("decode", epilog=fringe_decode.EPILOG)(fringe_decode.decode)
app.command("calibrate", epilog=fringe_calibrate.EPILOG)(fringe_calibrate.calibrate)
app.command("poses", epilog=fringe_poses.EPILOG)(fringe_poses.poses)
