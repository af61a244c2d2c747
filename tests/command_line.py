"""The command as a user types it, run in this process."""

import contextlib
import io
import re
from unittest import mock

import pytest

from virtual_sensor import cli

PROGRESS = re.compile(r"^ *\d+% after \d+ s: .*\n", re.MULTILINE)
"""What a command prints to standard error every 10 s, on a slow machine earlier than on others."""


def command(*arguments):
    """Run the command in this process: exit status, standard output and error but for progress."""
    out, err = io.StringIO(), io.StringIO()
    with (
        mock.patch("sys.argv", ["virtual-sensor", *map(str, arguments)]),
        mock.patch("signal.signal"),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as ended,
    ):
        cli.main()
    plain = [re.sub(r"\x1b\[[\d;]*m", "", text.getvalue()) for text in (out, err)]
    return ended.value.code or 0, plain[0], PROGRESS.sub("", plain[1])
