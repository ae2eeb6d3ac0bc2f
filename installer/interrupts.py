"""First step of the one-file program and of its launcher: one Ctrl-C is one interrupt, told in a line."""

import os
import signal
import sys
import time

ONE_INTERRUPT = 0.5  # [s] The launcher's process passes on the Ctrl-C that the terminal sends to both
_last_interrupt = [float("-inf")]


def interrupt(signum, frame):
    """Raise KeyboardInterrupt once for one Ctrl-C; before there is a program to catch it, leave with a line."""
    now = time.monotonic()
    first, _last_interrupt[0] = now - _last_interrupt[0] > ONE_INTERRUPT, now
    if not first:
        return
    if not hasattr(sys.modules["__main__"], "main"):
        os.write(2, b"vrgs: interrupted\n")
        os._exit(130)
    raise KeyboardInterrupt


signal.signal(signal.SIGINT, interrupt)
