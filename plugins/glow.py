"""The `glow` emitter: thermal radiation of a hot part, as it comes through a bandpass filter."""

from typing import Any

import numpy as np

from virtual_sensor.devices.planck import band_radiance
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError


class Glow(mi.Emitter):
    """A surface that glows: Planck's law times a grey emissivity, the same in all directions.

    ===============  ==========  ==================================================================
    Property         Default     Meaning
    ===============  ==========  ==================================================================
    temperature      (needed)    Of the surface, degC
    emissivity       0           From 0 (dark) to 1 (black body), at the filter's wavelength
    wavelength       532         Middle of the filter's band, nm
    bandwidth        10          Of the filter, nm: all light within, none beyond
    transmission     1           Of the filter within its band
    expansion        0           Of the shape, from 20 degC to the temperature: 1/K
    fixed_point      0, 0, 0     The point, mm, that stays where it is then
    ===============  ==========  ==================================================================

    It stands inside a shape.  What one part of the surface sheds on another is left out.
    """

    def __init__(self, props: mi.Properties) -> None:
        props["sampling_weight"] = _SELDOM
        super().__init__(props)
        if "temperature" not in props:
            raise InputError("glow: the property 'temperature' is missing; give it in degC")
        self.temperature_c = float(props["temperature"])
        shares = {name: float(props.get(name, default)) for name, default in _SHARES.items()}
        for name, share in shares.items():
            if not 0.0 <= share <= 1.0:
                raise InputError(f"glow: '{name}' is {share:g}; give it from 0 to 1")
        wavelength = float(props.get("wavelength", 532.0))
        bandwidth = float(props.get("bandwidth", 10.0))
        if not 0.0 < bandwidth <= 2.0 * wavelength:
            raise InputError(
                f"glow: a 'bandwidth' of {bandwidth:g} nm about {wavelength:g} nm can't be; give it"
                " above 0, and both in nm"
            )
        self.radiance = float(np.prod(list(shares.values())))
        if self.radiance > 0.0:
            self.radiance *= band_radiance(wavelength, bandwidth, self.temperature_c)
        for name in ("expansion", "fixed_point"):  # whoever loads the shape heeds them
            props.get(name, None)
        self.m_flags = mi.EmitterFlags.Surface

    def eval(self, si: mi.SurfaceInteraction3f, active: Any = True) -> Any:
        """Radiance in W/(mm^2 sr) of the surface's front."""
        outside = mi.Frame3f.cos_theta(si.wi) > 0.0
        return dr.select(active & outside, mi.Spectrum(self.radiance), 0.0)

    def sample_direction(
        self, it: mi.Interaction3f, sample: mi.Point2f, active: Any = True
    ) -> tuple[mi.DirectionSample3f, Any]:
        """Nothing: it lights nothing else."""
        return dr.zeros(mi.DirectionSample3f), mi.Spectrum(0.0)

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """Nil, as nothing is sampled."""
        return mi.Float(0.0)

    def to_string(self) -> str:
        """Its own values, for Mitsuba's scene listing."""
        return f"Glow[{self.temperature_c:g} degC, {self.radiance:.3g} W/(mm^2 sr)]"


# Integrators that choose a light at random should choose one that lights something; not 0, which
# they refuse in a scene that has no other light.
_SELDOM = 1e-6
_SHARES = {"emissivity": 0.0, "transmission": 1.0}

mi.register_emitter("glow", Glow)
