"""Files that are no calibrations, or say two things: refused in one line, at once."""

import pytest

from virtual_sensor.errors import InputError
from virtual_sensor.metrology.calibration import read_calibration


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x00\xff\x00",
        b"hello",
        b"%YAML:1.0\n---\na: [1, 2",
        b"{",
        b"%YAML:1.0\n---\n- 1\n",
        b"[1, 2]",
    ],
)
def test_files_that_are_something_else_are_refused(tmp_path, content):
    """Empty, binary, text, truncated: an error of ours, none of OpenCV's."""
    path = tmp_path / "sensor.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"sensor\.yaml"):
        read_calibration(path)
    with pytest.raises(InputError, match=r"missing\.yaml"):
        read_calibration(tmp_path / "missing.yaml")


def test_a_calibration_nested_without_end_is_refused(tmp_path):
    """OpenCV's parser calls itself until the stack ends the process: looked at before."""
    deep = 100_000
    texts = {
        "a.json": '{"a": ' + "[" * deep + "]" * deep + "}",
        "b.json": '{"a": ' * deep + "1" + "}" * deep,
        "c.yaml": "%YAML:1.0\n---\na: " + "[" * deep + "]" * deep + "\n",
        "d.yaml": "%YAML:1.0\n---\na:\n" + "- " * deep + "1\n",
        "e.yaml": "%YAML:1.0\n---\n" + "".join(f"{' ' * n}a:\n" for n in range(2000)),
        "f.xml": "<?xml version='1.0'?>\n<opencv_storage>" + "<a>" * deep + "</a>" * deep,
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match=rf"{name}: is nested over 100 levels deep"):
            read_calibration(tmp_path / name)
    with (tmp_path / "g.yaml").open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(InputError, match=r"g\.yaml: is too large"):
        read_calibration(tmp_path / "g.yaml")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("image_width: 2048\nimage_width: 1024\n", "'image_width' is there twice"),
        ('{"image_width": 2048, "image_width": 1024}', "'image_width' is there twice"),
        ("<o><image_width>2</image_width><image_width>1</image_width></o>", "is there twice"),
        ("image_width: 1e3x\n", "'image_width' must hold 1"),
        ("image_width: 1_000\n", "'image_width' must hold 1"),
        ("image_width: 9" + 400 * "0", "'image_width' must hold 1"),
        ('{"image_width": 9' + 400 * "0" + "}", "'image_width' must hold 1"),
        ("image_width: &a [*a]\n", "recursive"),
        ("a: []\n---\nb: []\n", "single document"),
        ("<!DOCTYPE o [<!ENTITY a '1'>]><o>&b;</o>", "undefined entity"),
        (
            "a0: &a0 []\n"
            + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 30))
            + "image_width: *a29\n",
            "'image_width' must hold 1",
        ),
        (
            "a0: &a0 [1]\n"
            + "".join(f"a{n}: &a{n} [*a{n - 1}]\n" for n in range(1, 5000))
            + "image_width: *a4999\n",
            "'image_width' must hold 1",
        ),
    ],
)
def test_what_says_two_things_or_no_number_is_refused(tmp_path, text, says):
    """The last of two would win in silence; references to references are many numbers."""
    path = tmp_path / "sensor.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=says) as told:
        read_calibration(path)
    assert "\n" not in str(told.value)


def test_a_file_that_ends_within_a_line_is_noted(tmp_path):
    """A number that is cut in two is a number still."""
    text = (
        "image_width: 640\nimage_height: 480\ncamera_matrix: [900, 0, 320, 0, 900, 240, 0, 0, 1]\n"
        "distortion_coefficients: [0, 0, 0, 0]\nrotation: [0, 0, 0]\ntranslation: [0, 0, 0]\n"
        "laser_plane:\n- 0.6\n- 0\n- 0.8\n- 240\n"
    )
    path = tmp_path / "c.yaml"
    for cut, notes in (
        (0, ()),
        (1, (f"{path}: ends within a line, as a file that is not whole does.",)),
    ):
        path.write_text(text[: len(text) - cut])
        assert read_calibration(path).notes == notes
