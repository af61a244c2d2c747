"""The command `virtual-sensor measure`."""

from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import shared
from virtual_sensor.imaging.recording_options import RecordingOptions

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor measure hot_cylinder\n\n"
    "    virtual-sensor measure hot_cylinder -D beta=15 -D line_radius=0.1 -o turned\n\n"
    "    virtual-sensor measure stepped_shaft -o shaft\n\n"
    "    virtual-sensor measure hot_cylinder --tolerance 0.01\n\n"
    "    virtual-sensor measure hot_cylinder --sensor-model cmos_5um5 --seed 1 -o recorded\n\n"
    "    virtual-sensor measure hot_cylinder -D f_number=8 --sensor-model cmos_5um5 --exposure 2ms"
    " --speckle"
)


@shared.with_options
def measure(
    scene: shared.SceneArgument,
    define: shared.Definitions = None,
    camera: shared.Camera = None,
    source: shared.Source = None,
    y: shared.ProbeRays = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="Error of the line centres, px, that is allowed: the cheapest settings that keep"
            " it are chosen, and printed."
        ),
    ] = None,
    output: shared.Folder = Path("measured"),
    overwrite: shared.Overwrite = False,
    *,
    recording: RecordingOptions,
) -> None:
    """Measure a part cold and hot: frames, line centres, points, ray search, a picture and a page.

    Recorded by an image sensor, the error is split into refraction, detector, pixels, speckle,
    noise and rounding.

    Of several cameras or lasers each pair is measured by itself, into a folder of its own.

    Exit status 3: there are results, but no frame has a line centre; a note says why.
    """
    from virtual_sensor.imaging.scene import load_scene
    from virtual_sensor.reporting.measure import on_console, save
    from virtual_sensor.studies.measure import measure as run

    shared.check_folder(output, overwrite)
    with shared.reporting("loading the scene") as report:
        loaded = load_scene(scene, **shared.definitions(define)).only(camera, source)
        if len(loaded.cameras) * len(loaded.sources) > 1 and tolerance is None:
            from virtual_sensor.reporting.pairs import pair_notes, pairs_table, save_pairs

            command = shared.command_line()
            pairs = save_pairs(
                loaded,
                lambda pair: run(pair, report, y or None, recording),
                output,
                command,
                overwrite,
            )
            shared.print_results([pairs_table(pairs)], pair_notes(pairs))
            shared.print_end(output)
            if not any(state.section.points for state in pairs.states):
                raise typer.Exit(shared.NOTHING_FOUND)
            return
        if tolerance is not None:
            from virtual_sensor.studies.tolerance import choose, configured

            report("choosing the settings", 0.0)
            configuration = choose(loaded, tolerance)
            loaded = configured(loaded, configuration)
            shared.console.print(f"{tolerance:g} px: {configuration}")
            shared.console.print(f"  because {'; '.join(configuration.why)}")
        result = run(
            loaded, lambda stage, fraction: report(stage, 0.9 * fraction), y or None, recording
        )
        report("writing the results", 0.92)
        figures = save(result, output, shared.command_line(), overwrite)
    shared.print_notes(result.caveats)
    others = [note for note in result.notes if note not in result.caveats]
    shared.print_results(on_console(figures), others)
    shared.print_end(output)
    if not result.centres:
        raise typer.Exit(shared.NOTHING_FOUND)
