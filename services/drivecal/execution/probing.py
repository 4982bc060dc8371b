"""Asks workers for the versions of tools outside of bundles (`probe`). Pure."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field, replace

from drivecal.contracts.work import Batch, BatchResult, SetupRequest

ASK_AGAIN_SECONDS = 10.0
"""Pause after every worker failed to run a probe."""


@dataclass(slots=True)
class _Question:
    request: SetupRequest
    answer: str | None = None
    batch: int | None = None
    """The batch that asks, at a worker now."""
    refusals: dict[str, str] = field(default_factory=dict)
    """Reasons of workers that gave no answer in this round; kept during the pause after it."""
    trouble: str | None = None
    """The last of all reasons."""
    not_before: float = 0.0
    """The end of the pause after every worker failed; 0 during a round."""

    def refuse(self, worker: str, reason: str) -> None:
        """Notes why a worker gave no answer."""
        self.refusals[worker] = reason
        self.trouble = f"{worker} cannot run the probe of {self.request.problem}: {reason}"


class Questions:
    """Probes that campaigns wait for, by tag. Each is run by one worker, and by another if that one fails."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._open: dict[str, _Question] = {}
        self._last = 0

    def ask(self, request: SetupRequest, tag: str) -> str | None:
        """Returns the answer once a worker has given it, and forgets it; None until then."""
        question = self._open.setdefault(tag, _Question(request))
        if question.answer is not None:
            del self._open[tag]
        return question.answer

    def forget(self, tag: str) -> None:
        """Drops the question of a campaign."""
        self._open.pop(tag, None)

    def batch_for(self, worker: str, ready: Collection[str]) -> tuple[int, Batch] | None:
        """Returns a question to send to a worker with a free slot, with its number: negative, as no other batch's is."""
        for question in self._open.values():
            if question.answer is not None or question.batch is not None or self._clock() < question.not_before:
                continue
            if question.not_before:  # the pause is over
                question.refusals.clear()
                question.not_before = 0.0
            if not set(ready) - question.refusals.keys():  # each has failed: from the start, after a pause
                question.not_before = self._clock() + ASK_AGAIN_SECONDS
            elif worker not in question.refusals:
                self._last -= 1
                question.batch = self._last
                return self._last, Batch(replace(question.request, tools=None), ())
        return None

    def answered(self, batch_id: int, result: BatchResult) -> None:
        """Takes an answer, or the reason for a missing one."""
        for question in self._sent(batch_id):
            question.answer = result.tools
            if result.tools is None:
                question.refuse(result.worker, result.refusal or "it gave no answer")

    def lost(self, batch_id: int, worker: str, detail: str) -> None:
        """Notes that a worker was lost while it was asked."""
        for question in self._sent(batch_id):
            question.refuse(worker, detail)

    def is_kept_from(self, worker: str) -> bool:
        """True if a campaign waits for an answer that this worker could not give."""
        return any(question.answer is None and worker in question.refusals for question in self._open.values())

    def trouble(self) -> str | None:
        """Returns why a campaign cannot start, or None."""
        return next((question.trouble for question in self._open.values() if question.trouble is not None), None)

    def _sent(self, batch_id: int) -> Iterator[_Question]:
        for question in self._open.values():
            if question.batch == batch_id:
                question.batch = None
                yield question
