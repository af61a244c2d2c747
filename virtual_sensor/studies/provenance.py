"""What results come from: engine, machine and versions, without which no figure can be repeated."""

from __future__ import annotations

import platform
from dataclasses import asdict, dataclass
from importlib import metadata
from typing import TYPE_CHECKING, Any

from virtual_sensor.records import Record

if TYPE_CHECKING:
    from virtual_sensor.imaging.scene import Scene


@dataclass(frozen=True)
class Versions(Record):
    """The versions that results come from which no engine made.

    Attributes
    ----------
    python, virtual_sensor, numpy, opencv : str
        Versions.
    """

    python: str
    virtual_sensor: str
    numpy: str
    opencv: str


@dataclass(frozen=True)
class MadeWith(Versions):
    """The engine and the versions that results come from.

    Attributes
    ----------
    variant : str
        Of Mitsuba.
    llvm : str or None
        Version of the library that compiles for the processor; None on a GPU.
    threads : int
        That compute.
    mitsuba, drjit : str
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
    mitsuba: str
    drjit: str
    transport: str | None = None
    samples_per_pixel: int | None = None
    march: str | None = None
    step_mm: float | None = None


def versions() -> Versions:
    """What runs here, without an engine being started."""
    return Versions(
        python=platform.python_version(),
        virtual_sensor=metadata.version("virtual-sensor"),
        numpy=metadata.version("numpy"),
        opencv=metadata.version("opencv-contrib-python-headless"),
    )


@dataclass(frozen=True)
class SceneFacts(Record):
    """The scene that results come from.

    Attributes
    ----------
    scene : str
        Its file.
    camera, source : str
        Their names in the scene.
    parameters : dict
        The scene's parameters as they were used.
    notes : tuple of str
        What the user should know.
    made_with : MadeWith
        Engine and versions.
    """

    scene: str
    camera: str
    source: str
    parameters: dict[str, str]
    notes: tuple[str, ...]
    made_with: MadeWith


def scene_facts(scene: Scene, notes: tuple[str, ...]) -> SceneFacts:
    """What results of a scene with one camera and one source come from."""
    return SceneFacts(
        str(scene.path),
        scene.camera_name,
        scene.source_name,
        dict(scene.parameters),
        notes,
        made_with(scene),
    )


def made_with(scene: Scene | None = None) -> MadeWith:
    """What runs here, and how a scene is rendered; `scene` has one camera."""
    from virtual_sensor import engine

    running = engine.activate()
    rendered: dict[str, Any] = {}
    if scene is not None:
        rendered = {
            "transport": scene.transport.name,
            "samples_per_pixel": int(scene.mitsuba_camera.sampler().sample_count()),
            "march": str(scene.transport.march),
            "step_mm": scene.transport.march.step_mm,
        }
    return MadeWith(
        **asdict(versions()),
        variant=running.variant,
        llvm=running.llvm.version if running.llvm else None,
        threads=running.threads,
        mitsuba=metadata.version("mitsuba"),
        drjit=metadata.version("drjit"),
        **rendered,
    )
