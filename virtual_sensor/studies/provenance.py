"""What results come from: engine, machine and versions, without which no figure can be repeated."""

from __future__ import annotations

import platform
from dataclasses import dataclass, replace
from importlib import metadata

from virtual_sensor import engine
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.records import Record


@dataclass(frozen=True)
class MadeWith(Record):
    """The engine and the versions that results come from.

    Attributes
    ----------
    variant : str
        Of Mitsuba.
    llvm : str or None
        Library that compiles for the processor; None on a GPU.
    threads : int
        That compute.
    python, virtual_sensor, mitsuba, drjit, numpy, opencv : str
        Versions.
    transport : str or None
        How light is carried through the air; None where no scene is rendered.
    samples_per_pixel : int or None
        Of a rendered frame.
    march : str or None
        Method and step of bent rays.
    step_mm : float or None
        Step of bent rays.
    """

    variant: str
    llvm: str | None
    threads: int
    python: str
    virtual_sensor: str
    mitsuba: str
    drjit: str
    numpy: str
    opencv: str
    transport: str | None = None
    samples_per_pixel: int | None = None
    march: str | None = None
    step_mm: float | None = None


def made_with(scene: Scene | None = None) -> MadeWith:
    """What runs here, and how a scene is rendered; `scene` has one camera."""
    running = engine.activate()
    found = MadeWith(
        variant=running.variant,
        llvm=str(running.llvm.path) if running.llvm else None,
        threads=running.threads,
        python=platform.python_version(),
        virtual_sensor=metadata.version("virtual-sensor"),
        mitsuba=metadata.version("mitsuba"),
        drjit=metadata.version("drjit"),
        numpy=metadata.version("numpy"),
        opencv=metadata.version("opencv-contrib-python-headless"),
    )
    if scene is None:
        return found
    return replace(
        found,
        transport=scene.transport.name,
        samples_per_pixel=int(scene.mitsuba_camera.sampler().sample_count()),
        march=str(scene.transport.march),
        step_mm=scene.transport.march.step_mm,
    )
