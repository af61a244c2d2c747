"""The examples run as written, and find what can be worked out without them."""

from pathlib import Path

import numpy as np
import trimesh

SHIPPED = Path(__file__).parents[1] / "scenes" / "meshes"


def test_the_parts_are_closed_and_as_large_as_their_drawings_say():
    """Rationale: the volume of the drawing, worked out by hand, is that of the mesh."""
    for name, size_mm, volume_mm3 in [
        ("bracket", (40.0, 60.0, 30.0), 19779.4),
        ("gear_blank", (60.0, 60.0, 25.0), 45620.8),
    ]:
        file = SHIPPED / f"{name}.stl"
        part = trimesh.load(file)
        assert part.is_watertight, name
        assert part.is_winding_consistent, name
        np.testing.assert_allclose(part.extents, size_mm, atol=1e-4)
        np.testing.assert_allclose(part.volume, volume_mm3, rtol=3e-4)
        assert file.stat().st_size < 300_000
