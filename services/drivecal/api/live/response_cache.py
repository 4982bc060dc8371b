"""Answers that were put together a moment ago: of a hundred clients that follow a running campaign, most ask for the same revision."""

import time
from collections.abc import Callable
from dataclasses import dataclass

SECONDS = 1.0
"""Largest age of a repeated answer, whose times are as old."""
MOST = 64
LARGEST = 65_536
"""Bytes of an answer that is remembered: together at most 4 MB."""


@dataclass(frozen=True, slots=True)
class _Answer:
    tag: str
    made_at: float
    body: bytes


class ResponseCache:
    """The last answer about each of a few campaigns, by its ETag. Any thread may ask and tell."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._answers: dict[str, _Answer] = {}

    def find(self, campaign: str, tag: str) -> bytes | None:
        """The answer with this ETag, if it was given a moment ago."""
        answer = self._answers.get(campaign)
        return answer.body if answer is not None and answer.tag == tag and self._clock() - answer.made_at < SECONDS else None

    def keep(self, campaign: str, tag: str, body: bytes) -> None:
        """Takes the place of the answer before."""
        if len(body) > LARGEST:
            return
        if campaign not in self._answers and len(self._answers) >= MOST:
            self._answers = {}  # rarely, and then they are back within a second
        self._answers[campaign] = _Answer(tag, self._clock(), body)
