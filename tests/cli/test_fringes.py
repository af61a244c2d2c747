"""The command `fringes`: a scene or a word."""

import typer

from virtual_sensor.cli.fringes import SceneOrWord


def said(*arguments):
    """What a command that takes a scene or the word `decode` is called with."""
    calls = []
    app = typer.Typer(cls=SceneOrWord, invoke_without_command=True)

    @app.callback()
    def run(scene: str, bits: int = 8):
        calls.append(("scene", scene, bits))

    @app.command()
    def decode(shots: str, bits: int = 12):
        calls.append(("decode", shots, bits))

    typer.main.get_command(app)(arguments, standalone_mode=False)
    return calls


def test_a_word_stands_in_the_scenes_place():
    """Rationale: options of a command with words below it must stand before its arguments."""
    assert said("mine.xml", "--bits", "10") == [("scene", "mine.xml", 10)]
    assert said("--bits", "10", "mine.xml") == [("scene", "mine.xml", 10)]
    assert said("decode", "shots", "--bits", "10") == [("decode", "shots", 10)]
    assert said("./decode") == [("scene", "./decode", 8)]
