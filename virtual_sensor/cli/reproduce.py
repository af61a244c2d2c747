"""The command `virtual-sensor reproduce`."""

from pathlib import Path

from virtual_sensor.cli import shared

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor reproduce\n\n"
    "    virtual-sensor reproduce -o finer -D spp=64 -D step=1\n\n"
    "    virtual-sensor reproduce -o fast --scheduler tcp://127.0.0.1:8786"
)


def reproduce(
    output: shared.FolderToGoOnIn = Path("reproduced"),
    define: shared.Definitions = None,
    scheduler: shared.Scheduler = None,
) -> None:
    """Remake section 5 of Beermann et al. 2018, and set every statement beside the paper's.

    Figures 6, 7, 9, 10(b) and 11 by ray search and by rendered frames, through the air as simulated
    and through air as broad as the paper's; and what the paper could not do: whole lines, all
    poses, a dense reconstruction. Finished work stays: stopped or killed, the same command goes on.
    """
    from virtual_sensor.reporting.measure import save as save_case
    from virtual_sensor.reporting.reproduction import on_console, save
    from virtual_sensor.studies.reproduction.reproduce import reproduce as run

    shared.check_folder_name(output)
    with shared.reporting("reading what is finished", shared.FINISHED_STAYS) as report:
        result = run(
            output,
            save_case,
            shared.definitions(define),
            scheduler,
            lambda stage, fraction: report(stage, 0.93 * fraction),
        )
        report("drawing and writing", 0.93)
        save(result, output, shared.command_line())
    shared.print_results(on_console(result), result.summary.notes)
    shared.print_end(output, "report/report.html")
