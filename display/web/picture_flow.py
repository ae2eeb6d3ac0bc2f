"""Flow of pictures to one page: as many under way as its connection needs, and as good as it carries in time."""

from __future__ import annotations

import math
from collections import deque

PERIOD = 1 / 30  # [s] between pictures for which a far page gets several at once
MAX_UNDER_WAY = 8  # pictures: a delay of a quarter of a second
QUALITIES = (35, 50, 65, 80)  # of JPEG while things move
STILL_QUALITY = 95  # once they are at rest
SLOW, FAST = 1 / 20, 1 / 60  # [s] of the way of a picture beyond that of a small message: worse, better pictures
WORSE_AFTER, BETTER_AFTER = 3, 30  # pictures in a row
DELAYS = 20  # measurements of the connection's delay of which the least counts: larger ones waited for something
MAX_GAP = 0.25  # [s] between pictures that follow one another
HISTORY_LENGTH = 36_000  # latencies and intervals kept: ten minutes at 60 Hz


class PictureFlow:
    """Pictures under way to a page, and those that arrived. Times in seconds.

    A picture is sent only while fewer than `window` are unanswered: one beyond those that the connection's delay keeps
    under way, so that none waits behind another. Its quality falls while pictures take SLOW longer than small
    messages, and rises again.
    """

    def __init__(self):
        self.frames = self.bytes = 0  # sent
        self.latencies: deque[float] = deque(maxlen=HISTORY_LENGTH)  # [s] from input to its picture on view
        self.intervals: deque[float] = deque(maxlen=HISTORY_LENGTH)  # [s] between pictures that follow one another
        self.last: tuple[int, int] = (-1, 0)  # the picture that the page has or will have, and its quality
        self._sent: deque[tuple[int, float]] = deque()  # number and time of what is unanswered
        self._number = 0
        self._delays: deque[float] = deque(maxlen=DELAYS)
        self._level, self._slow, self._fast = len(QUALITIES) - 1, 0, 0
        self._shown: float | None = None  # when the last picture was

    @property
    def quality(self) -> int:
        """Quality of the next picture while things move."""
        return QUALITIES[self._level]

    @property
    def delay(self) -> float:
        """Time to the page and back [s]."""
        return min(self._delays, default=0.0)

    @property
    def window(self) -> int:
        """Pictures that may be under way."""
        return min(1 + math.ceil(self.delay / PERIOD), MAX_UNDER_WAY)

    @property
    def ready(self) -> bool:
        """May another picture be sent?"""
        return len(self._sent) < self.window

    @property
    def idle(self) -> bool:
        """True if nothing is under way: then a small message measures the delay."""
        return not self._sent

    def note_delay(self, seconds: float) -> None:
        """Note how long a small message took there and back."""
        self._delays.append(seconds)

    def send(self, now: float, picture: int, quality: int) -> int:
        """Note that a picture goes out; its number."""
        self._number += 1
        self._sent.append((self._number, now))
        self.last = (picture, quality)
        return self._number

    def count(self, size: int) -> None:
        """Note the bytes of a picture that went out."""
        self.frames, self.bytes = self.frames + 1, self.bytes + size

    def shown(self, number: int, now: float, latency: float | None) -> bool:
        """Note that the page shows a picture, `latency` after the last input in it; False if it was not sent."""
        numbers = [n for n, _ in self._sent]
        if number not in numbers:
            return False
        while self._sent[0][0] != number:  # older ones were passed over
            self._sent.popleft()
        _, sent = self._sent.popleft()
        if latency is not None:
            self.latencies.append(latency)
        if self._shown is not None and now - self._shown <= MAX_GAP:
            self.intervals.append(now - self._shown)
        self._shown = now
        self._adapt(now - sent - self.delay)
        return True

    def _adapt(self, transfer: float) -> None:
        """Change the quality by the time that a picture's transfer took."""
        self._slow = self._slow + 1 if transfer > SLOW else 0
        self._fast = self._fast + 1 if transfer < FAST else 0
        if self._slow >= WORSE_AFTER and self._level > 0:
            self._level, self._slow = self._level - 1, 0
        elif self._fast >= BETTER_AFTER and self._level < len(QUALITIES) - 1:
            self._level, self._fast = self._level + 1, 0
