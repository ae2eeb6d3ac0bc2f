"""A message to the user that is shown for some seconds."""

from __future__ import annotations

from time import monotonic

NOTICE_SECONDS = 6.0  # [s]


class Notice:
    """The last message; `shown` is empty once its time is over."""

    def __init__(self):
        self._text, self._until = "", 0.0

    @property
    def shown(self) -> str:
        """The message while it is to be seen."""
        return self._text if monotonic() < self._until else ""

    def tell(self, text: str) -> None:
        """Show a message from now on."""
        self._text, self._until = text, monotonic() + NOTICE_SECONDS

    def clear(self) -> None:
        """Show nothing."""
        self._until = 0.0
