"""The Mitsuba plugins: refractive integrator, laser line, projector, camera, glow of a hot part.

Importing this package registers them for the variant that is set, and again whenever Mitsuba
changes its variant: registration is per variant, and a class can only derive from Mitsuba's once
one is set.
"""

import importlib
import sys
from typing import Any

from virtual_sensor.engine import mi

_NAMES = "laser_line", "glow", "refractive", "pattern_projector", "lens_camera"
_PLUGINS = tuple(f"virtual_sensor_plugins.{name}" for name in _NAMES)


_of_variant: dict[str, dict[str, dict[str, Any]]] = {}


def _register(old: str | None = None, new: str | None = None) -> None:
    """Load the plugins for a variant; one that was set before gets its own classes back.

    Scenes that were loaded under it are made of these.
    """
    known = _of_variant.setdefault(new or mi.variant(), {})
    for name in _PLUGINS:
        if name in known:
            vars(sys.modules[name]).update(known[name])
            continue
        if name in sys.modules:
            importlib.reload(sys.modules[name])
        else:
            importlib.import_module(name)
        known[name] = dict(vars(sys.modules[name]))


mi.detail.add_variant_callback(_register)
_register()
