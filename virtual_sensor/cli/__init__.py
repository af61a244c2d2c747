"""The command `virtual-sensor`: arguments to studies, nothing else."""

from virtual_sensor.cli.commands import app, main

__all__ = ["app", "main"]
