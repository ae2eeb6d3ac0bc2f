"""Ctrl-C where a library would swallow it."""

import signal

import pytest

from core.runtime import interrupts_held


def test_an_interrupt_acts_after_what_would_swallow_it():
    after = []
    with pytest.raises(KeyboardInterrupt), interrupts_held():
        try:
            signal.raise_signal(signal.SIGINT)
            after.append("went on")
        except:  # noqa: E722 as Taichi does
            after.append("swallowed")
    assert after == ["went on"] and signal.getsignal(signal.SIGINT) is signal.default_int_handler
