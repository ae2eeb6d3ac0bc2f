"""What the user reads on stderr when something about the headset changes: one line each, once."""

from __future__ import annotations

import sys
import time

from core.errors import BadInput

PATIENCE = 2.0  # [s] before a headset that nobody wears yet is asked for
OFF = 0.2  # [s] without a frame, and it was taken off
OFTEN, LATELY = 5, 60.0  # so many losses in so many seconds, and it is given up


class StatusLog:
    """Follows a session and tells."""

    def __init__(self):
        self._resting: float | None = None  # since when
        self._played = self._told = False
        self._focused: bool | None = None
        self._tracked = True
        self._losses: list[float] = []

    def tell(self, line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    def rest(self) -> None:
        """No frames are wanted."""
        now = time.monotonic()
        if self._resting is None:
            self._resting, self._told, self._focused = now, False, None
        if not self._told and now - self._resting > (OFF if self._played else PATIENCE):
            self._told = True
            self.tell("the headset is off: the play is paused" if self._played else "put the headset on to begin")

    def frame(self, session) -> None:
        """A frame begins."""
        if self._told and self._played:
            self.tell("the headset is on: the play goes on")
        self._resting, self._played, self._told = None, True, False
        if session.focused != self._focused and self._focused is not None:
            self.tell(
                "your hands are here again" if session.focused else "something else has your hands: they rest here"
            )
        if session.focused or self._focused is not None:  # at the start it takes a few frames
            self._focused = session.focused
        if session.tracked != self._tracked:
            self._tracked = session.tracked
            self.tell(
                "the head is seen again" if self._tracked else "the head is not seen: the view stays where it was"
            )

    def lost(self, name: str, why: str) -> None:
        """The runtime went away. BadInput if it does nothing else."""
        now = time.monotonic()
        self._losses = [at for at in self._losses if now - at < LATELY] + [now]
        if len(self._losses) >= OFTEN:
            raise BadInput(f"--xr: {name} fails again and again ({why}); start it anew, or play without --xr")
        self._focused = None
        self.tell(f"the headset's runtime went away ({why}); waiting for it to come back")
