"""Our image sensors as the package `emva1288` finds them: frames that are recorded, stored, read.

python benchmarks/emva1288_package.py               two minutes, with what pip installs
python benchmarks/emva1288_package.py --python P    of an environment that has emva1288

A surface of known radiance is recorded through a lens, by exposures that grow; the package gets the
TIFF files and how many photons fell on a pixel, by the radiometry of a textbook, and says what
sensor it was.  It needs a NumPy of its own, before 2: without --python a virtual environment is
made for it, and removed afterwards.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import venv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.constants import c, h, nano

PACKAGES = ("emva1288==1.0.2", "numpy<2", "setuptools<81")
MOST = 0.02
"""By which a value may differ, relative to the data sheet's."""

SIDE_PX = 300
LEVELS = 50
STACK = 100
LONGEST_S = 4.0
DARK = 0.05  # of the full well, at most, fills with dark current
LEAST_DN2 = 0.24  # of dark variance: less can't be told from rounding, the standard says
F_NUMBER, FOCAL_MM, DISTANCE_MM = 8.0, 75.0, 300.0

PEER = """
import json, logging, sys
from emva1288.process import Data1288, LoadImageData, ParseEmvaDescriptorFile, Results1288
logging.disable(logging.CRITICAL)
said = ParseEmvaDescriptorFile(sys.argv[1])
found = Results1288(Data1288(LoadImageData(said.images).data).data)
print(json.dumps({
    "quantum_efficiency": found.QE / 100.0, "gain": found.K, "dark_noise_e": found.sigma_d,
    "dsnu_e": found.DSNU1288, "prnu": found.PRNU1288 / 100.0,
    "dark_current_e_s": found.u_I_mean, "dark_current_e_s by variance": found.u_I_var,
    "full_well_e": found.u_e_sat,
}))
"""


def photons_per_radiance(pixel_um: float, exposure_s: float, wavelength_nm: float) -> float:
    """Photons on a pixel for 1 W/(mm^2 sr): pi L A t lambda/(4 (N (1 + m))^2 h c)."""
    working = F_NUMBER * (1.0 + FOCAL_MM / DISTANCE_MM)
    energy_j = np.pi / (4.0 * working**2) * (pixel_um * 1e-3) ** 2 * exposure_s
    return float(energy_j * wavelength_nm * nano / (h * c))


def recorded(sensor: Any, folder: Path, side_px: int = SIDE_PX, stack: int = STACK) -> Path:
    """Record all frames that the standard asks for; the file that describes them to the package."""
    import virtual_sensor as vs

    scene = vs.load_scene(
        "cold_cylinder",
        width=side_px,
        height=side_px,
        pixel=sensor.pixel_um,
        focal_length=FOCAL_MM,
        distance=DISTANCE_MM,
        f_number=F_NUMBER,
    )
    wavelength_nm = scene.air.wavelength_nm
    longest_s = min(LONGEST_S, DARK * sensor.full_well_e / data_sheet(sensor)["dark_current_e_s"])
    longest = photons_per_radiance(sensor.pixel_um, longest_s, wavelength_nm)
    efficiency = sensor.at_wavelength(wavelength_nm).quantum_efficiency
    radiance = 1.05 * sensor.full_well_e / efficiency / longest
    bright = np.full((side_px, side_px), radiance)
    lines, seed = [f"v 4.0\nn {sensor.bit_depth} {side_px} {side_px}"], 0

    def taken(time_s: float, frames: int) -> None:
        nonlocal seed
        photons = radiance * photons_per_radiance(sensor.pixel_um, time_s, wavelength_nm)
        for light, count in ((bright, photons), (0.0 * bright, 0.0)):
            kind = f"b {time_s * 1e9:.12g} {count:.12g}" if count else f"d {time_s * 1e9:.12g}"
            lines.append(kind)
            for _ in range(frames):
                shot = vs.record(scene, light, seed, sensor=sensor, exposure_s=time_s)
                path = vs.save_tiff(shot, folder / f"{seed:05d}.tif")
                lines.append(f"i {path.name}")
                seed += 1

    for time_s in np.linspace(0.0, longest_s, LEVELS + 1)[1:]:
        taken(float(time_s), 2)
    taken(0.5 * longest_s, stack)
    description = folder / "frames.txt"
    description.write_text("\n".join(lines) + "\n", encoding="ascii")
    return description


def data_sheet(sensor: Any, wavelength_nm: float = 532.0) -> dict[str, float]:
    """What the package is to find."""
    warmer = (sensor.temperature_c - sensor.dark_current_at_c) / sensor.doubling_c
    dark = sensor.dark_current_e_s * 2.0**warmer
    names = ("gain", "dark_noise_e", "dsnu_e", "prnu", "full_well_e")
    return {
        "quantum_efficiency": sensor.at_wavelength(wavelength_nm).quantum_efficiency,
        **{name: getattr(sensor, name) for name in names},
        "dark_current_e_s": dark,
        "dark_current_e_s by variance": dark,
    }


def main() -> int:
    """Print what was found of each sensor; exit with 1 where it differs by too much."""
    import virtual_sensor as vs

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--python", help=f"interpreter that has {PACKAGES[0]}")
    asked = parser.parse_args()
    failed = False
    print(f"{'sensor':<16} {'':<28} {'data sheet':>10} {'found':>10}")
    with tempfile.TemporaryDirectory() as folder:
        python = asked.python
        if python is None:
            venv.create(f"{folder}/venv", with_pip=True)
            python = f"{folder}/venv/bin/python"
            subprocess.run([python, "-m", "pip", "install", "-q", *PACKAGES], check=True)
        for name in vs.image_sensors():
            place = Path(folder) / name
            place.mkdir()
            sensor = replace(vs.image_sensor(name), knee=None)  # the standard's linear camera
            described = recorded(sensor, place)
            told = subprocess.run(
                [python, "-c", PEER, str(described)], check=True, capture_output=True, text=True
            )
            found = json.loads(told.stdout)
            for key, value in data_sheet(sensor).items():
                off = found[key] / value - 1.0
                words = ""
                if key == "full_well_e":
                    words = "where the noise is largest, above the dark signal"
                elif key == "dark_noise_e" and (sensor.gain * value) ** 2 < LEAST_DN2:
                    words = "below what its bits can show"
                else:
                    failed |= not abs(off) < MOST
                print(f"{name:<16} {key:<28} {value:10.4g} {found[key]:10.4g} {off:+8.2%} {words}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
