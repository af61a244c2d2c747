"""The command as a user types it, run in this process."""

import contextlib
import io
import re
from unittest import mock

import pytest

from virtual_sensor import cli

PROGRESS = re.compile(r"^ *\d+% after \d+ s: .*\n", re.MULTILINE)
"""What a command prints to standard error every 10 s, on a slow machine earlier than on others."""


def status_of(arguments, out, err):
    """Run the command in this process, with such streams; give its exit status."""
    with (
        mock.patch("sys.argv", ["virtual-sensor", *map(str, arguments)]),
        mock.patch("signal.signal"),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as ended,
    ):
        cli.main()
    return ended.value.code or 0


def command(*arguments):
    """Run the command in this process: exit status, standard output and error but for progress."""
    out, err = io.StringIO(), io.StringIO()
    status = status_of(arguments, out, err)
    plain = [re.sub(r"\x1b\[[\d;]*m", "", text.getvalue()) for text in (out, err)]
    return status, plain[0], PROGRESS.sub("", plain[1])
