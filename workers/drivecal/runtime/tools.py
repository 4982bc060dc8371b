"""Versions of tools outside of bundles on this worker: what a bundle's `probe` answers, compared with what the campaign began with."""

import socket
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from drivecal.adapters.command import run_probe
from drivecal.contracts.work import BundleRequest
from drivecal.domain.errors import UnavailableError

ASK_AGAIN_SECONDS = 600.0
"""Age of an answer after which the probe runs again: tools may be upgraded while a worker lives."""
_SHOWN = 150


class OtherToolsError(UnavailableError):
    """This machine has other versions of tools than the campaign began with. `answer`: of the probe here."""

    def __init__(self, command: str, answer: str, expected: str) -> None:
        super().__init__(
            f"the probe `{command}` answers {_shown(answer)} on {socket.gethostname()} and {_shown(expected)} in this campaign;"
            " install the same version on all machines, or submit the campaign again"
        )
        self.answer = answer


class Tools:
    """Answers of probes, by bundle."""

    def __init__(
        self,
        run: Callable[[Mapping[str, Any], Path], str] = run_probe,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._run, self._clock = run, clock
        self._answers: dict[str, tuple[str, float]] = {}

    def ask(self, setup: BundleRequest, folder: Path) -> str:
        """Runs the probe of a bundle in `folder`. Raises UnavailableError if it gives no answer."""
        answer = self._run(setup.simulator, folder)
        self._answers[setup.bundle] = answer, self._clock()
        return answer

    def check(self, setup: BundleRequest, folder: Callable[[], Path]) -> None:
        """Raises OtherToolsError if the tools are not those of the setup. The probe runs unless its last answer is recent and agrees."""
        if setup.tools is None:
            return
        answer, since = self._answers.get(setup.bundle, ("", 0.0))
        if answer != setup.tools or self._clock() >= since + ASK_AGAIN_SECONDS:
            answer = self.ask(setup, folder())
        if answer != setup.tools:
            raise OtherToolsError(" ".join(setup.simulator["probe"]), answer, setup.tools)


def _shown(answer: str) -> str:
    text = " ".join(answer.split())
    return repr(text if len(text) <= _SHOWN else f"{text[:_SHOWN]}...")
