"""The text of a new scene: XML whose parameters say what they are."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from virtual_sensor_plugins.interreflection import INDIRECT_SAMPLES
from virtual_sensor_plugins.renderer import DIRECT

from virtual_sensor.imaging.camera_parameters import with_field_of_view
from virtual_sensor.imaging.new_scene.options import NewScene
from virtual_sensor.imaging.new_scene.part import NewPart
from virtual_sensor.imaging.new_scene.placement import Placement

PROJECTOR_PX = 1280, 800
"""Of a projector's image: a usual DMD's."""

Rows = list[tuple[str, object, str]]
"""Parameters: name, value, and what it is."""

WAVELENGTH_NM = 532.0
"""Of the laser, by default."""


def scene_text(
    name: str, part: NewPart, part_place: str, sensor: Placement, said: NewScene, field: str
) -> str:
    """A scene's XML; `part_place` and `field` are the files' names from its folder."""
    rows = [*_air(said, field), *_surface(part, said), *_poses(sensor, said)]
    rows += _devices(sensor, said)
    values = {name: value_text(value) for name, value, _ in rows}
    values = with_field_of_view(values, {})
    lines = []
    for parameter, _, words in rows:
        tag = f'<default name="{parameter}" value={quoteattr(values[parameter])}/>'
        lines.append(f"{tag:<43} <!-- {words} -->")
    return _template().render(
        name=name.replace("--", "- -"),
        part=part,
        part_place=part_place,
        parameters=lines,
        cameras=_numbered("camera", sensor.alphas, "alpha"),
        projector=said.projector,
        sources=_sources(sensor, said),
        offset=any(sensor.offsets_mm),
        glows=said.temperature_c is not None,
    )


def _numbered(stem: str, each: tuple[float, ...], *parameters: str) -> list[dict[str, str]]:
    """The names of devices and of their parameters, numbered where there are several."""
    ends = [""] if len(each) == 1 else [f"_{number + 1}" for number in range(len(each))]
    return [{name: f"{name}{end}" for name in (stem, *parameters)} for end in ends]


def _sources(sensor: Placement, said: NewScene) -> list[dict[str, str]]:
    """The names of the lasers or projectors, as `name`, and of their parameters."""
    stem = "projector" if said.projector else "laser"
    numbered = _numbered(stem, sensor.tilts, "tilt", "laser_offset")
    return [{"name": names.pop(stem), **names} for names in numbered]


def _air(said: NewScene, field: str) -> Rows:
    hot: Rows = [
        ("temperature", said.temperature_c, "of the part, degC"),
        ("expansion", 0, "of the part from 20 degC on, 1/K: 0, none; steel: 12e-6"),
        ("emissivity", 0, "of the part at the wavelength: 0, no glow; oxidised steel: 0.8"),
    ]
    return [
        *(hot if said.temperature_c is not None else []),
        ("field", field, "of the hot air: a file, or one that is installed; empty: none"),
        ("time", "", "flow time of the air, s; empty: the field's last"),
        ("pressure", "", "of the air, Pa; empty: as the field has it"),
        ("wavelength", said.wavelength_nm or WAVELENGTH_NM, "of the light, nm"),
    ]


def _surface(part: NewPart, said: NewScene) -> Rows:
    metal = said.roughness is not None
    material = said.material or ("ground_steel" if metal else "diffuse")
    words = "of the part: one that is installed, such as ground_steel, or a file"
    rows: Rows = [("material", material, words)]
    if metal:
        words = "of the material, alpha of GGX, from 0.05, shiny, to 0.5, dull"
        rows.append(("roughness", said.roughness, words))
    if part.radius_mm:
        words = "of the part per unit of its texture coordinate {}, mm"
        rows.append(("u_mm", 2.0 * np.pi * part.radius_mm, words.format("u, round it")))
        rows.append(("v_mm", 2.0 * part.half_length_mm, words.format("v, along it")))
    return rows


def _poses(sensor: Placement, said: NewScene) -> Rows:
    cameras = _numbered("camera", sensor.alphas, "alpha")
    sources = _sources(sensor, said)
    from_source = f"{sources[0]['name']} to {{}}, degrees: the triangulation angle"
    line = "columns lie" if said.projector else "line lies"
    rows: Rows = [
        (names["alpha"], value, from_source.format(names["camera"]))
        for names, value in zip(cameras, sensor.alphas, strict=True)
    ]
    rows += [
        (names["tilt"], value, f"{names['name']} from the vertical, degrees")
        for names, value in zip(sources, sensor.tilts, strict=True)
    ]
    rows += [
        (names["laser_offset"], value, f"{names['name']} beside the middle, across its line, mm")
        for names, value in zip(sources, sensor.offsets_mm, strict=True)
        if any(sensor.offsets_mm)
    ]
    return [
        *rows,
        ("beta", said.beta or 0, "sensor round its x-axis, degrees"),
        ("turn", said.turn or 0, f"sensor round the vertical, degrees; 0: its {line} along y"),
        ("along", 0, "sensor along its x-axis, mm: to scan"),
        *(
            (f"at_{axis}", value, f"{axis} of the middle of the light, mm")
            for axis, value in zip("xyz", sensor.at_mm, strict=True)
        ),
    ]


def _line(sensor: Placement, said: NewScene) -> Rows:
    return [
        ("line_length", sensor.line_length_mm, "mm"),
        ("line_radius", sensor.line_radius_mm, "to 1/e^2, across the sheet, mm"),
        ("fan", said.fan or 0, "full fan angle, degrees; 0: a sheet of parallel light"),
        ("dots", "", "positions along the line, mm; empty: a line"),
        ("line_profile", "gaussian", 'gaussian, "tails 0.12 2.5", "super 4", or a table\'s file'),
        ("line_uniformity", 1, "its ends' light over that in the middle, or a table's file"),
        ("beam_quality", "", "of the laser: M^2, 1 of an ideal beam; empty: no focus"),
        ("waist_distance", "", "of its focus from the laser, mm; empty: laser_distance"),
        ("linewidth", 0, "of the laser's spectrum at half its height, nm: for speckle"),
        ("rq", 0, "roughness of the lit surface, um: for speckle"),
        ("polarisations", 1, "of its speckle; 2: the surface depolarises"),
        ("modes", 1, "of the laser, whose speckles add"),
        ("laser_distance", sensor.laser_distance_mm, "from the laser's exit to the line, mm"),
    ]


def _projected(sensor: Placement) -> Rows:
    """A projector's parameters: its image covers what the cameras see."""
    width, height = PROJECTOR_PX
    along_mm, across_mm = (
        n * sensor.pixel_um / 1000.0 * sensor.distance_mm / sensor.focal_mm for n in sensor.size_px
    )
    slant = min(abs(np.cos(np.radians(alpha))) for alpha in sensor.alphas)
    image_mm = max(along_mm * width / height, across_mm / max(slant, 0.5))
    fov = 2.0 * np.degrees(np.arctan(image_mm / 2.0 / sensor.distance_mm))
    return [
        ("pattern", "white", "that is thrown: white, sine u 16 0, checker 40, an image file ..."),
        ("pixels", "true", "the projector's are square; false: the pattern is shown as it is"),
        ("contrast", 0, "of its light, white over black; 0: black is dark"),
        ("gamma", 1, "its light goes with the grey value to this power"),
        ("bits", 0, "to which it rounds grey values; 0: not at all"),
        ("defocus", 0, "standard deviation of its image's blur, px of its own"),
        ("power", 0.1, "of an all-white image, W"),
        ("projector_width", width, "of its image, px"),
        ("projector_height", height, "of its image, px"),
        ("projector_fov", float(f"{fov:.4g}"), "along its width, degrees"),
        ("projector_distance", sensor.distance_mm, "from its lens to the light's middle, mm"),
    ]


def _devices(sensor: Placement, said: NewScene) -> Rows:
    width, height = sensor.size_px
    return [
        *(_projected(sensor) if said.projector else _line(sensor, said)),
        ("distance", sensor.distance_mm, "from the camera to the light's middle, mm"),
        ("focal_length", sensor.focal_mm, "mm"),
        ("film_width", width * sensor.pixel_um / 1000.0, "mm"),
        ("pixel", sensor.pixel_um, "um; where given, film_width is width times it"),
        ("fov", 1, "degrees; unless given, it follows from focal_length"),
        ("width", width, "film, px; alone it leaves the field of view"),
        ("height", height, "px"),
        *_lens(said),
        ("spp", 16, "samples per pixel, a square number"),
        *_bounces(said),
        ("transport", "tabulated", "of light: tabulated, marched, first_order, straight"),
        ("tolerance", 0.003, "of the tables, px"),
        ("step", 2, "of the ray march, mm"),
    ]


def _bounces(said: NewScene) -> Rows:
    """Reflections between surfaces, which direct light has not."""
    depth = DIRECT if said.max_depth is None else said.max_depth
    points = INDIRECT_SAMPLES if said.indirect_samples is None else said.indirect_samples
    return [
        ("max_depth", depth, "of light's path: 2, direct; 3, with one reflection"),
        ("indirect_samples", points, "of the lit stripe, for such reflections"),
    ]


def _lens(said: NewScene) -> Rows:
    """What a camera has that a pinhole has not."""
    tilt = "of the camera's sensor about its rows, degrees; empty: none"
    if not said.projector:
        tilt = tilt.replace("; empty", ", or laser_plane: as focuses that; empty")
    return [
        ("f_number", said.f_number or "", "of the lens: focal length by pupil; empty: a pinhole"),
        ("focus_distance", said.focus_distance_mm or "$distance", "from the lens, mm"),
        ("sensor_tilt", said.sensor_tilt or "", tilt),
        ("distortion", said.distortion or "", "of the lens: OpenCV's k1, k2, p1, p2, k3 ..."),
        ("calibration", said.calibration or "", "file of matrix and distortion, in place of fov"),
        ("sub_pupils", 16, "points of the lens's pupil; 1: its light without its blur"),
        ("sensor_model", said.sensor_model or "", "image sensor that records; empty: none"),
        ("exposure", said.exposure or "", "of a recorded frame: 2ms, 500us; empty: automatic"),
    ]


def value_text(value: object) -> str:
    """A parameter's value as a scene's text has it."""
    return f"{value:.9g}" if isinstance(value, (int, float)) else f"{value}"


@cache
def _template() -> Any:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template("scene.xml.j2")
