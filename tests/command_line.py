"""The command as a user types it, run in this process."""

import contextlib
import io
import re
from unittest import mock

import pytest

from virtual_sensor import cli


def command(*arguments):
    """Run the command in this process: exit status, standard output, standard error."""
    out, err = io.StringIO(), io.StringIO()
    with (
        mock.patch("sys.argv", ["virtual-sensor", *map(str, arguments)]),
        mock.patch("signal.signal"),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as ended,
    ):
        cli.main()
    plain = (re.sub(r"\x1b\[[\d;]*m", "", text.getvalue()) for text in (out, err))
    return ended.value.code or 0, *plain
