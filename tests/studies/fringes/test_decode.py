"""A user's own sequence of images: one command decodes it, and what is wrong with it is told."""

import json
import shutil

import numpy as np
import OpenEXR
import pytest
from command_line import command

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.studies.fringes.decode import DecodeSettings, decode_sequence, sequence_files
from virtual_sensor.studies.fringes.decoded_files import read_decoded

CODEC = "phase 8 16,1280 u"
NOISE = 1.5


@pytest.fixture(scope="module")
def truth():
    """Columns (H, W) that the camera's pixels see, and what they reflect."""
    v, u = np.mgrid[:90, :120].astype(float)
    column = 200.0 + 5.0 * u + 0.002 * (v - 45.0) ** 2
    light = np.where((np.abs(v - 45.0) < 40.0) & (u > 8.0), 0.7 + 0.002 * v, 0.0)
    return column, light


@pytest.fixture(scope="module")
def shots(truth, tmp_path_factory):
    """A folder with 16 PNG files of 8 bits, numbered without leading zeros."""
    folder = tmp_path_factory.mktemp("shots")
    column, light = truth
    rng = np.random.default_rng(8)
    for number, pattern in enumerate(vs.codec_of(CODEC).patterns, 1):
        grey = 6.0 + 230.0 * light * pattern.grey(column, column)
        grey = np.clip(np.rint(grey + rng.normal(0.0, NOISE, grey.shape)), 0, 255)
        vs.save_png(grey.astype(np.uint8), folder / f"shot {number}.png", bits=8)
    return folder


def copied(shots, folder, without=()):
    shutil.copytree(shots, folder)
    for number in without:
        (folder / f"shot {number}.png").unlink()
    return folder


def decoded(folder, codec=CODEC, **options):
    return decode_sequence(sequence_files([folder])[0], DecodeSettings(codec, **options))


def test_sixteen_files_are_decoded_by_one_command(shots, truth, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    formats = [word for each in ("exr", "npz", "csv") for word in ("--format", each)]
    asked = ("fringes", "decode", shots, "--codec", CODEC, "-o", "out", "--black", "6")
    status, said, wrong = command(*asked, *formats)
    assert status == 0, wrong
    assert "have a projector pixel" in " ".join(said.split())
    column, light = truth
    found = read_decoded(tmp_path / "out/decoded.exr")
    assert (found.status[light == 0.0] != vs.FringeStatus.OK).all()
    assert np.mean(found.ok[light > 0.0]) > 0.9
    error = (found.column - column)[found.ok]
    assert np.std(error) == pytest.approx(np.nanmedian(found.sigma_column), rel=0.1)
    assert found.noise == pytest.approx(NOISE, rel=0.1)
    layers = OpenEXR.File(str(tmp_path / "out/decoded.exr"), separate_channels=True).channels()
    assert {"projector.u", "sigma.u", "phase.u", "status"} <= layers.keys()
    with np.load(tmp_path / "out/decoded.npz") as held:
        np.testing.assert_allclose(held["column"], found.column, atol=1e-3)
    rows = np.loadtxt(tmp_path / "out/decoded.csv", delimiter=",", skiprows=1)
    assert len(rows) == found.ok.sum()
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    assert summary["found"]["images"] == 16
    assert summary["found"]["disorder"] < 0.25
    table = (tmp_path / "out/images.csv").read_text().splitlines()
    assert table[10].split(",")[:3] == ['"u 1280 px', ' step 2 of 8"', "shot 10.png"]
    assert (tmp_path / "out/report.png").stat().st_size > 10_000
    assert "shot 16.png" in (tmp_path / "out/report.html").read_text()
    status, _, wrong = command(*asked)
    assert status == 2
    assert "exists" in wrong


def test_a_wrong_number_of_files_is_told_with_what_is_missing_or_spare(shots, tmp_path):
    fewer = copied(shots, tmp_path / "fewer", [11])
    missing = r"15 images, but .* 16 patterns: 'u 1280 px, step 3 of 8' is missing, between shot 10"
    with pytest.raises(InputError, match=missing):
        decoded(fewer)
    more = copied(shots, tmp_path / "more")
    vs.save_png(np.full((90, 120), 240, np.uint8), more / "all white.png", bits=8)
    with pytest.raises(InputError, match=r"all white\.png fit none of them; leave it out"):
        decoded(more)
    twice = copied(shots, tmp_path / "twice")
    shutil.copy(twice / "shot 3.png", twice / "shot 3 copy.png")
    with pytest.raises(InputError, match="are the same image"):
        decoded(twice)
    again = vs.read_image(more / "shot 3.png").pixels
    (more / "all white.png").unlink()
    noise = np.random.default_rng(9).normal(0.0, NOISE, again.shape)
    again = np.clip(again + np.rint(noise), 0, 255).astype(np.uint8)
    vs.save_png(again, more / "shot 4.png", bits=8)
    same = r"shot 3\.png \('u 16 px, step 3 of 8'\) and shot 4\.png .* are the same image"
    with pytest.raises(InputError, match=same):
        decoded(more)
    with pytest.raises(InputError, match=r"1 images, but .* has 16 patterns"):
        decode_sequence([shots / "shot 1.png"], DecodeSettings(CODEC))
    with pytest.raises(InputError, match=r"4 images.*16 patterns: .* and 12 more; give one image"):
        decoded(copied(shots, tmp_path / "few", range(5, 17)))


def test_a_wrong_order_is_told_and_may_be_put_right(shots, truth, tmp_path):
    column = truth[0]
    usual = decoded(shots)
    again = read_decoded(usual.decoded.save(tmp_path / "usual.exr"))
    np.testing.assert_allclose(again.column, usual.decoded.column, rtol=1e-6)
    assert [path.name for path in usual.paths[8:11]] == ["shot 9.png", "shot 10.png", "shot 11.png"]
    mixed = copied(shots, tmp_path / "mixed")
    (mixed / "shot 2.png").rename(mixed / "x.png")
    (mixed / "shot 12.png").rename(mixed / "shot 2.png")
    (mixed / "x.png").rename(mixed / "shot 12.png")
    with pytest.raises(InputError, match=r"shot 2\.png and shot 12\.png are exchanged; rename"):
        decoded(mixed)
    result = decoded(mixed, order="auto")
    assert np.nanmax(np.abs(result.decoded.column - column)) < 0.5
    assert "are exchanged" in result.notes[0]
    with pytest.raises(InputError, match="they fit it as 'fine-first'; say --order fine-first"):
        decoded(shots, "phase 8 1280,16 u")
    result = decoded(shots, "phase 8 1280,16 u", order="fine-first")
    np.testing.assert_array_equal(result.decoded.column, usual.decoded.column)
    with pytest.raises(InputError, match="--order upside-down: take one of usual, auto, coarse-fi"):
        decoded(shots, order="upside-down")
    result = decoded(shots, "phase 4 16,1280 uv")
    assert "contradict" in result.notes[0]
    assert result.summary.disorder > 0.45


def test_other_slips_are_told(shots, tmp_path):
    other = copied(shots, tmp_path / "other", [16])
    vs.save_png(np.zeros((90, 100), np.uint8), other / "shot 16.png", bits=8)
    with pytest.raises(InputError, match=r"shot 16\.png: is 100 x 90 px, but shot 1\.png is 120"):
        decoded(other)
    vs.save_png(np.zeros((90, 120), np.uint16), other / "shot 16.png", bits=16)
    with pytest.raises(InputError, match=r"shot 16\.png: holds uint16, but shot 1\.png uint8"):
        decoded(other)
    for options, words in (
        (["--size", "1280"], "--size 1280: write it as WIDTHxHEIGHT"),
        (["--codec", "phase 8 16,128 u"], "is shorter than the image's 1280 columns"),
        (["--format", "xlsx"], "take one of exr, npz, csv"),
        (["--bits", "8", "--saturation", "9"], "choose one of them"),
    ):
        status, _, wrong = command("fringes", "decode", shots, "-o", tmp_path / "no", *options)
        assert status == 2
        assert words in wrong, options
    assert not (tmp_path / "no").exists()


def test_doubts_are_noted(shots, truth, tmp_path):
    """Expected behaviour: of dark images 3 is the exit status; clipped and turned ones are told."""
    dark = tmp_path / "dark"
    dark.mkdir()
    for number in range(16):
        vs.save_png(np.full((40, 50), 3, np.uint8), dark / f"{number}.png", bits=8)
    status, said, _ = command("fringes", "decode", dark, "--codec", CODEC, "-o", tmp_path / "out")
    assert status == 3
    assert "No pixel has a projector pixel" in said
    clipped = decoded(shots, saturation=150.0)
    assert any("of the lit pixels are saturated" in note for note in clipped.notes)
    turned = decoded(shots, order="steps-backwards")
    assert any("Columns fall from pixel to pixel" in note for note in turned.notes)
    assert not any("fall from" in note for note in decoded(shots).notes)
    alone = decode_sequence([shots / "shot 1.png"], DecodeSettings("single 16 u"))
    assert any("lack whole periods" in note for note in alone.notes)
