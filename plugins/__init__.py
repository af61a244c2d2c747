"""The Mitsuba plugins: the refractive integrator, the laser line and the glow of a hot part.

Importing this package registers them for the variant that is set, and again whenever Mitsuba
changes its variant: registration is per variant, and a class can only derive from Mitsuba's once
one is set.
"""

import importlib
import sys

from virtual_sensor.engine import mi

_PLUGINS = tuple(f"virtual_sensor_plugins.{name}" for name in ("laser_line", "glow", "refractive"))


def _register(old: str | None = None, new: str | None = None) -> None:
    for name in _PLUGINS:
        if name in sys.modules:
            importlib.reload(sys.modules[name])
        else:
            importlib.import_module(name)


mi.detail.add_variant_callback(_register)
_register()
