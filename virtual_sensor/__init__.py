"""A virtual laser-triangulation sensor that sees through hot air.

>>> import virtual_sensor as vs
>>> scene = vs.load_scene("hot_cylinder", beta=15)
>>> image = vs.render(scene)
>>> line = vs.line_centres(image)
>>> points_mm = vs.triangulate(scene, line.pixel)

Names are loaded when first used: those that compute with Dr.Jit start the engine then. Whoever
imports drjit or mitsuba afterwards gets an LLVM library that is proven to work.
"""

import contextlib
import importlib
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from virtual_sensor.errors import EngineError as EngineError
    from virtual_sensor.errors import InputError as InputError
    from virtual_sensor.imaging.camera_noise import CameraNoise as CameraNoise
    from virtual_sensor.imaging.camera_noise import record as record
    from virtual_sensor.imaging.image_files import read_image as read_image
    from virtual_sensor.imaging.image_files import save_png as save_png
    from virtual_sensor.imaging.new_scene.write import new_scene as new_scene
    from virtual_sensor.imaging.render import render as render
    from virtual_sensor.imaging.render import render_frame as render_frame
    from virtual_sensor.imaging.scene import load_scene as load_scene
    from virtual_sensor.medium.air import air_refractivity as air_refractivity
    from virtual_sensor.medium.index_field import IndexField as IndexField
    from virtual_sensor.metrology.centres import LineCentres as LineCentres
    from virtual_sensor.metrology.centres import Status as Status
    from virtual_sensor.metrology.line_peaks import line_centres as line_centres
    from virtual_sensor.metrology.triangulation import triangulate as triangulate
    from virtual_sensor.metrology.truth import TrueLine as TrueLine
    from virtual_sensor.metrology.truth import compare_line as compare_line
    from virtual_sensor.optics.projection import project as project
    from virtual_sensor.optics.ray_search import ray_search as ray_search
    from virtual_sensor.optics.ray_status import RayStatus as RayStatus
    from virtual_sensor.optics.trace import trace as trace
    from virtual_sensor.poses import Pose as Pose

_HOME = {
    "CameraNoise": "imaging.camera_noise",
    "EngineError": "errors",
    "IndexField": "medium.index_field",
    "InputError": "errors",
    "LineCentres": "metrology.centres",
    "Pose": "poses",
    "RayStatus": "optics.ray_status",
    "Status": "metrology.centres",
    "TrueLine": "metrology.truth",
    "air_refractivity": "medium.air",
    "compare_line": "metrology.truth",
    "line_centres": "metrology.line_peaks",
    "load_scene": "imaging.scene",
    "new_scene": "imaging.new_scene.write",
    "project": "optics.projection",
    "ray_search": "optics.ray_search",
    "read_image": "imaging.image_files",
    "record": "imaging.camera_noise",
    "render": "imaging.render",
    "render_frame": "imaging.render",
    "save_png": "imaging.image_files",
    "trace": "optics.trace",
    "triangulate": "metrology.triangulation",
}

__all__ = list(_HOME)


class _LlvmFirst:
    """Has an LLVM library chosen at the moment at which drjit is imported, by whomever.

    By default Dr.Jit takes the system's newest, of which some abort at the first kernel.
    """

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        """Find nothing: the other finders import drjit."""
        if name == "drjit":
            from virtual_sensor import engine

            with contextlib.suppress(engine.EngineError):  # reported when the engine starts
                engine.choose_llvm()


if "drjit" not in sys.modules:
    sys.meta_path.insert(0, _LlvmFirst)


if not TYPE_CHECKING:  # a checker would take any name for one of ours

    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            raise AttributeError(f"module 'virtual_sensor' has no attribute '{name}'")
        return getattr(importlib.import_module(f"virtual_sensor.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return __all__
