r"""Writes meshes/bracket.stl and meshes/gear_blank.stl, in mm, as a CAD program would export them.

To run it again takes `pip install manifold3d`.

    bracket, z over y, x from -20 to 20      gear blank, z over r
    z 30           __                         25   __               hub; bore 16 with a keyway
                  |  |  upright, hole of 8    20  |  \       ___
       6 __   __ /   |  inner fillet of 8     12  |   \_____/   |   web; rim with chamfers
       0 __| |_______|  countersunk hole       0  |____________|
         -30    y   30                            8    r      30
"""

from pathlib import Path

import numpy as np
import trimesh
from manifold3d import CrossSection, Manifold

FAR = 100.0  # beyond the parts


def arc(middle: tuple[float, float], radius: float, start: int, end: int) -> np.ndarray:
    """Points (N, 2) of an arc, one every two degrees."""
    angle = np.radians(np.linspace(start, end, abs(end - start) // 2 + 1))
    return np.array(middle) + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def rounded(x: tuple[float, float], y: tuple[float, float], radius: float) -> np.ndarray:
    """Outline (N, 2) of a rectangle with round corners."""
    ends = [(x[1], y[1], -1, -1), (x[0], y[1], 1, -1), (x[0], y[0], 1, 1), (x[1], y[0], -1, 1)]
    corners = [(a + i * radius, b + j * radius) for a, b, i, j in ends]
    return np.vstack([arc(c, radius, 90 * k, 90 * k + 90) for k, c in enumerate(corners)])


def extruded(outline: np.ndarray, height: float) -> Manifold:
    """An anticlockwise outline (x, y), from z = 0 to a height."""
    return Manifold.extrude(CrossSection([outline]), height)


def bracket() -> Manifold:
    """Base and upright of 6 mm, 60 x 40 x 30 mm; the origin under the middle of its base."""
    fillet = arc((16.0, 14.0), 8.0, 0, -90)
    side = np.vstack([[(-30, 6), (-30, 0), (30, 0), (30, 30), (24, 30)], fillet])  # (y, z)
    body = extruded(side, 40.0).translate([0, 0, -20]).rotate([90, 0, 90])
    plan = extruded(rounded((-20, 20), (-30, FAR), 6.0), FAR)  # round corners of the base
    front = extruded(rounded((-20, 20), (-FAR, 30), 6.0), FAR).rotate([90, 0, 0])  # of the upright
    screw = Manifold.cylinder(FAR, 4.0, 4.0, 180, center=True)
    sink = Manifold.cylinder(4.0, 3.0, 7.0, 180).translate([0, 0, 2])  # 90 degrees, 14 mm on top
    bolt = screw.rotate([90, 0, 0]).translate([0, FAR / 2, 20])
    return (
        (body ^ plan ^ front.translate([0, FAR / 2, 0]))
        - (screw + sink).translate([0, -8, 0])
        - bolt
    )


def gear_blank() -> Manifold:
    """A turned disc of 60 mm, its axis z, with a bore of 16 mm and a keyway of 5 mm."""
    rim = [(8, 0), (29, 0), (30, 1), (30, 19), (29, 20), (24, 20), (22, 12)]
    hub = [(15, 12), (13, 24), (12, 25), (8, 25)]
    disc = Manifold.revolve(CrossSection([np.array([*rim, *hub], float)]), 240)  # (r, z)
    return disc - Manifold.cube([5, 10.3, FAR], center=True).translate([0, 5.15, 0])


def export(part: Manifold, path: Path) -> None:
    """Write a part as binary STL."""
    mesh = part.to_mesh()
    trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts).export(path)


if __name__ == "__main__":
    folder = Path(__file__).parent / "meshes"
    export(bracket(), folder / "bracket.stl")
    export(gear_blank(), folder / "gear_blank.stl")
