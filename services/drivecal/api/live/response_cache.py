"""Cache of recent answers: of a hundred clients that follow a running campaign, most ask for the same revision."""

import time
from collections.abc import Callable
from dataclasses import dataclass

SECONDS = 1.0
"""Largest age of a repeated answer."""
MOST = 64
LARGEST = 65_536
"""Largest size of a cached answer in bytes; all together take at most 4 MB."""


@dataclass(frozen=True, slots=True)
class _Answer:
    tag: str
    made_at: float
    body: bytes


class ResponseCache:
    """The last answer about each of a few campaigns, by its ETag. Thread-safe."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._answers: dict[str, _Answer] = {}

    def find(self, campaign: str, tag: str) -> bytes | None:
        """Returns the answer with this ETag if it is recent enough."""
        answer = self._answers.get(campaign)
        return answer.body if answer is not None and answer.tag == tag and self._clock() - answer.made_at < SECONDS else None

    def keep(self, campaign: str, tag: str, body: bytes) -> None:
        """Replaces the last answer."""
        if len(body) > LARGEST:
            return
        if campaign not in self._answers and len(self._answers) >= MOST:
            self._answers = {}  # rarely, and then they are back within a second
        self._answers[campaign] = _Answer(tag, self._clock(), body)
