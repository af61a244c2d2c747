"""Decoded fringes as files: what is written is read again."""

from dataclasses import fields

import numpy as np
import OpenEXR
import pytest

from virtual_sensor.errors import InputError
from virtual_sensor.metrology.fringes.decoded import DecodedFringes, FringeStatus
from virtual_sensor.studies.fringes.decoded_files import LAYERS, read_decoded, write_decoded


def fringes(axes="uv"):
    """Of a camera of 6 x 4 px, some of whose pixels see nothing."""
    rng = np.random.default_rng(0)
    status = np.where(rng.random((4, 6)) < 0.3, FringeStatus.BLACK, FringeStatus.OK)
    dark = status != FringeStatus.OK

    def image(scale):
        values = (scale * rng.random((4, 6))).astype(np.float32)
        values[dark] = np.nan
        return values

    pairs = {"u": ("column", "sigma_column"), "v": ("row", "sigma_row")}
    given = {name: None for pair in pairs.values() for name in pair}
    for axis in axes:
        place, sigma = pairs[axis]
        given |= {place: image(1280.0).astype(float), sigma: image(1e-2)}
    return DecodedFringes(
        **given,
        modulation=image(0.5),
        mean=image(0.5),
        phase={axis: image(6.0) for axis in axes},
        status=status.astype(np.uint8),
        size_px=(1280, 800),
        absolute=False,
        wrong_orders=1e-4,
        noise=0.25,
        notes=("a note: µ",),
    )


def test_what_is_written_is_read_again(tmp_path):
    """To the bit, with one axis or both, and whatever layers stand beside it."""
    path = tmp_path / "cold.exr"
    for axes in ("uv", "u", "v"):
        decoded = fringes(axes)
        extra = np.full((4, 6), 2.0, np.float32)
        write_decoded(path, decoded, {"straight.Z": extra}, {"virtual_sensor/codec": "phase 4"})
        again = read_decoded(path)
        for each in fields(DecodedFringes):
            one, other = getattr(decoded, each.name), getattr(again, each.name)
            if isinstance(one, np.ndarray):
                assert one.dtype == other.dtype, each.name
        assert again == decoded
    with OpenEXR.File(str(path), separate_channels=True) as file:
        names = set(file.channels())
        assert (file.channels()["straight.Z"].pixels == 2.0).all()
        assert file.header()["virtual_sensor/codec"] == "phase 4"
    known = {name for each in LAYERS for name in each.name.split(", ")}
    assert names - {"straight.Z"} <= known
    assert {"projector.v", "projector.u"} & names == {"projector.v"}


def test_another_file_is_refused(tmp_path):
    """Named, with what to give: a file that is none, another image, one that is cut, none."""
    other, text, cut = (tmp_path / name for name in ("frame.exr", "text.exr", "cut.exr"))
    OpenEXR.File({}, {"Y": np.zeros((4, 6), np.float32)}).write(str(other))
    text.write_text("no image")
    write_decoded(cut, fringes())
    cut.write_bytes(cut.read_bytes()[:300])
    for path in (other, text, cut, tmp_path / "none.exr"):
        with pytest.raises(InputError, match=path.name):
            read_decoded(path)
