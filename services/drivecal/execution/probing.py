"""Asks workers for the versions of tools outside of bundles (`probe`), and notes workers whose answers differ from a campaign's, or whose
refusals say that no worker can run a setup. Pure."""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace

from drivecal.contracts.work import Batch, BatchResult, SetupKey, SetupRequest
from drivecal.execution.scheduling.in_flight import WITNESSES

PATIENCE_WITH_ANSWERS = 60.0
"""Seconds with another answer and without an agreeing worker after which a campaign is hopeless. A worker that refuses is replaced after
half of it, and then runs the probe again."""
ASK_AGAIN_SECONDS = 10.0
"""Pause after every worker failed to run a probe."""
MOST_REASONS = 5
"""Different reasons of refusing workers in a message."""


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


@dataclass(slots=True)
class _Dispute:
    refusals: dict[str, str] = field(default_factory=dict)
    """Reasons of the workers that answer otherwise, or not at all."""
    differing: set[str] = field(default_factory=set)
    """Workers that answer otherwise."""
    since: float | None = None
    """Time of the first other answer."""
    unsuitable: dict[str, str] = field(default_factory=dict)
    """Reasons of workers that blame the problem's files, by worker."""
    nodes: set[str] = field(default_factory=set)
    """Nodes of these workers."""


class Disputes:
    """Setups of problems that workers refuse: their tools have other versions than the campaign began with, or none is known, or the
    problem's files cannot be run anywhere."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._open: dict[SetupKey, _Dispute] = {}

    @property
    def are_open(self) -> bool:
        """True if there are disputes."""
        return bool(self._open)

    def keep(self, setups: Collection[SetupKey]) -> None:
        """Drops all other setups: no campaign waits for them."""
        self._open = {setup: dispute for setup, dispute in self._open.items() if setup in setups}

    def note(self, setup: SetupRequest, result: BatchResult, node: str) -> None:
        """Takes the result of a batch: a refusal, whatever its reason, or proof that a worker agrees. `node`: the worker's."""
        if result.refusal is None:
            self._open.pop(setup.key, None)
            return
        if setup.tools is None and not result.unsuitable:
            return
        dispute = self._open.setdefault(setup.key, _Dispute())
        if result.unsuitable:
            dispute.unsuitable[result.worker] = f"no worker can run the scenario {setup.scenario}: {result.refusal}"
            dispute.nodes.add(node)
        dispute.refusals[result.worker] = result.refusal
        if result.tools is not None:
            dispute.differing.add(result.worker)
            dispute.since = self._clock() if dispute.since is None else dispute.since

    def hopeless(self, setups: Collection[SetupKey], ready: Mapping[str, str]) -> str | None:
        """Returns the reasons why none of the workers will run one of these setups, or None. `ready`: nodes of the workers by name.

        A second worker has to confirm that the problem's files are to blame, if there is one, and on a second node if there are several:
        the first may be damaged. A setup whose probe breaks at all workers is waited for: a licence server or a mount may come back.
        """
        workers, nodes = (min(WITNESSES, max(count, 1)) for count in (len(ready), len(set(ready.values()))))
        for setup in self._open.keys() & set(setups):
            dispute = self._open[setup]
            if len(dispute.unsuitable) >= workers and len(dispute.nodes) >= nodes:
                return "; ".join(dict.fromkeys(dispute.unsuitable.values()))
            if dispute.since is None or self._clock() < dispute.since + PATIENCE_WITH_ANSWERS:
                continue
            if dispute.differing & ready.keys() and dispute.refusals.keys() >= ready.keys():
                reasons = dict.fromkeys(dispute.refusals[worker] for worker in ready)
                return "; ".join(list(reasons)[:MOST_REASONS])
        return None
