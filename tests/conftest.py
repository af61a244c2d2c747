"""What holds for all tests."""

import signal

# Started in the background of a shell, Ctrl-C is ignored, and by the commands that tests start too.
signal.signal(signal.SIGINT, signal.default_int_handler)
