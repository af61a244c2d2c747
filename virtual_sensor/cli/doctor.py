"""The command `virtual-sensor doctor`."""

import typer

from virtual_sensor.cli import shared

EPILOG = (
    "Examples:\n\n    virtual-sensor doctor\n\n    virtual-sensor --variant cuda_ad_mono doctor"
)


def doctor() -> None:
    """Say what this machine computes with, and what to install if it can't.

    Exit status 1: something is missing.
    """
    from virtual_sensor.reporting.doctor import report
    from virtual_sensor.studies.doctor import diagnose

    diagnosis = diagnose()
    shared.console.print(report(diagnosis))
    raise typer.Exit(0 if diagnosis.ok else 1)
