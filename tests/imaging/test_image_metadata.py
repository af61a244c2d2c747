"""Files say how their grey values came about, and detection heeds it: 8 to 16 bits, every kind."""

import json

import cv2
import numpy as np
import PIL.Image
import pytest
import tifffile

import virtual_sensor as vs
from virtual_sensor.imaging.image_metadata import KEY
from virtual_sensor.records import write_layers
from virtual_sensor.studies.detect import Settings, detect

ROW = np.arange(40.0)[:, None]
LIGHT = np.exp(-((ROW - 20.3) ** 2) / 4.5) * np.ones(60)
SENSOR = vs.image_sensor("cmos_5um5")
KNOWN = SENSOR.detector_options


def grey_of(bits):
    gain = SENSOR.gain * 2.0**bits / 4096
    black = SENSOR.black_level * 2.0**bits / 4096
    sensor = vs.ImageSensor(gain=gain, black_level=black, bit_depth=bits, full_well_e=13_000)
    return sensor, vs.grey_values(LIGHT, sensor, peak_e=9000.0)


def test_grey_values_and_what_is_known_of_them_come_back(tmp_path):
    """PNG and TIFF, packed or not, of 8 to 16 bits; other libraries read the same grey values."""
    for bits in (8, 10, 12, 14, 16):
        sensor, grey = grey_of(bits)
        files = [
            vs.save_png(grey, tmp_path / f"{bits}.png", sensor=sensor, metadata={"seed": 7}),
            vs.save_tiff(grey, tmp_path / f"{bits}.tif", sensor=sensor, metadata={"seed": 7}),
            vs.save_tiff(grey, tmp_path / f"p{bits}.tiff", sensor=sensor, packed=True),
        ]
        for path in files:
            read = vs.read_image(path)
            np.testing.assert_array_equal(read.pixels, grey)
            assert read.detector_options == pytest.approx(sensor.detector_options)
            assert read.largest == sensor.saturation
            assert read.notes == ()
            assert read.metadata["sensor"]["bit_depth"] == bits
        assert vs.read_image(files[0]).metadata["seed"] == 7
        for path in files[:2]:
            np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), grey)
        with tifffile.TiffFile(files[2]) as file:
            assert file.pages[0].bitspersample == bits
        assert files[2].stat().st_size < grey.size * bits / 8 + 2000


def test_without_a_sensor_the_bits_are_said(tmp_path):
    """As PNG files say them: 12 by default."""
    light = vs.read_image(vs.save_tiff(LIGHT, tmp_path / "light.tif", white=1.0))
    assert (light.largest, light.notes, light.detector_options) == (4095.0, (), {})
    assert light.pixels.max() == round(4095 * LIGHT.max())
    assert vs.read_image(vs.save_tiff(LIGHT, tmp_path / "a.tif", 10)).largest == 1023.0


def write_beside(path, metadata):
    path.with_name(f"{path.name}.json").write_text(json.dumps(metadata))


def test_a_header_and_a_file_beside_say_it_too(tmp_path):
    """Of OpenEXR and of any camera's files; what is said beside goes first."""
    _, grey = grey_of(12)
    exr, bmp = tmp_path / "a.exr", tmp_path / "a.bmp"
    write_layers(exr, {"Y": grey.astype(float)}, {KEY: json.dumps(KNOWN)})
    assert vs.read_image(exr).detector_options == pytest.approx(KNOWN)
    cv2.imwrite(str(bmp), (grey >> 4).astype(np.uint8))
    write_beside(bmp, {"noise": 0.8, "gain": 0.02})
    assert vs.read_image(bmp).detector_options == {"noise": 0.8, "gain": 0.02}
    write_beside(exr, {"noise": 0.5})
    assert vs.read_image(exr).detector_options == pytest.approx(KNOWN | {"noise": 0.5})
    (tmp_path / "a.bmp.json").write_text("noise = 0.8")
    with pytest.raises(vs.InputError, match=r"a\.bmp\.json: is no JSON object, such as"):
        vs.read_image(bmp)


def test_what_can_not_be_is_noted_and_not_used(tmp_path):
    """Rationale: a file may have been changed by a program that keeps its texts."""
    sensor, grey = grey_of(12)
    path = vs.save_png(grey, tmp_path / "a.png", sensor=sensor)
    other_bits = vs.read_image(path, bits=10)
    assert not other_bits.detector_options
    assert "for 12 bits, not 10: they are not used" in " ".join(other_bits.notes)
    with PIL.Image.open(path) as image:
        text = image.info[KEY]
    brighter = np.clip(grey.astype(int) * 3, 0, 65535).astype(np.uint16)
    tifffile.imwrite(tmp_path / "b.tif", brighter, description=json.dumps({KEY: json.loads(text)}))
    changed = vs.read_image(tmp_path / "b.tif")
    assert not changed.detector_options
    assert "was it changed since? They are not used" in " ".join(changed.notes)
    write_beside(path, {"noise": -1.0, "gain": "much", "black": None})
    odd = vs.read_image(path)
    assert odd.detector_options.keys() == {"saturation"}
    assert "its noise is -1.0, which can't be: not used" in " ".join(odd.notes)
    for description in ("{", '{"virtual_sensor": 5}', '{"shape": [40, 60]}', "[1]", "words"):
        tifffile.imwrite(tmp_path / "c.tif", grey, description=description, metadata=None)
        assert vs.read_image(tmp_path / "c.tif").metadata == {}


def test_detection_heeds_what_the_file_says(tmp_path):
    """And says so; an option that is given goes first."""
    light = LIGHT * np.linspace(0.2, 1.0, 60)
    grey = vs.grey_values(light, SENSOR, peak_e=20_000.0)
    path = vs.save_png(grey, tmp_path / "a.png", sensor=SENSOR)
    image = vs.read_image(path)
    told = vs.line_centres(grey, "max_likelihood", sensor=SENSOR)
    assert vs.line_centres(image, "max_likelihood") == told
    assert {*np.unique(told.status)} == {vs.Status.OK, vs.Status.CLIPPED}
    write_beside(path, {"seed": 1})
    [found] = detect([path], Settings("max_likelihood"))
    assert found.line == told
    assert any("noise 3.781 and gain 0.29, which are used" in remark for remark in found.remarks)
    [given] = detect([path], Settings("max_likelihood", noise=5.0, gain=1.0, saturation=4095.0))
    assert not any("noise" in remark for remark in given.remarks)
    found_there = told.status == vs.Status.OK
    assert np.all(given.line.sigma[found_there] > 1.3 * told.sigma[found_there])


def test_grey_values_beyond_a_knee_are_stretched_back(tmp_path):
    """Of a file as of a recorded frame: a line whose peak is bent has its centres all the same."""
    sensor = vs.ImageSensor(knee=(0.3, 6.0), prnu=0.0, dsnu_e=0.0)
    grey = vs.grey_values(LIGHT, sensor, peak_e=30_000.0)
    path = vs.save_png(grey, tmp_path / "a.png", sensor=sensor)
    image = vs.read_image(path)
    assert image.sensor == sensor
    straight = image.linear_grey.pixels
    light_e = LIGHT * 30_000.0
    noise_e = np.sqrt(light_e * 5.7 / 0.7) + 30.0  # beyond the knee an electron stands for several
    assert np.all(np.abs(straight - 64.0 - 0.37 * light_e) < 0.37 * 5.0 * noise_e)
    clipped = image.linear_grey.detector_options["saturation"]
    assert clipped == pytest.approx(64 + 0.37 * 6 * 10_500, rel=1e-3)
    for line in (vs.line_centres(image), detected(path)):
        assert np.all(line.status == vs.Status.OK)
        assert np.sqrt(np.mean((line.row - 20.3) ** 2)) < 0.03
    bent = vs.line_centres(grey)
    assert np.median(bent.width) > 1.2 * np.median(line.width)


def detected(path):
    [found] = detect([path], Settings())
    assert any("knee-point" in remark for remark in found.remarks)
    return found.line


def test_what_a_tiff_cant_hold_is_told(tmp_path):
    """As of a PNG: nothing is written."""
    _, grey = grey_of(12)
    for words, image, options in (
        ("end it with .tif", grey, {"path": tmp_path / "a.png"}),
        ("save_tiff: image has negative values", -LIGHT, {}),
        ("save_tiff: image has grey values up to", grey, {"bits": 8}),
        ("save_tiff: packed is 1; give True or False", grey, {"packed": 1}),
        ("save_tiff: metadata is 'x'; give a mapping", grey, {"metadata": "x"}),
        ("save_tiff: metadata can't be written as JSON", grey, {"metadata": {"a": object()}}),
        ("save_tiff: sensor is 'cmos'; give an ImageSensor", grey, {"sensor": "cmos"}),
        ("image holds floats; give grey_values", LIGHT, {"sensor": SENSOR}),
    ):
        with pytest.raises(vs.InputError, match=words):
            vs.save_tiff(image, **({"path": tmp_path / "a.tif"} | options))
    assert not list(tmp_path.iterdir())
