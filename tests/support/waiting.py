"""Waiting for what another process or thread does."""

import time
from collections.abc import Callable

PATIENCE = 60.0  # [s]


def until(condition: Callable[[], object], seconds: float = PATIENCE, what: str = "") -> None:
    """Wait until a condition holds."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"not in time: {what}"
        time.sleep(0.02)
