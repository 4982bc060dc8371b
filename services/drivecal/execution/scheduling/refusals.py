"""Refusals of setups: which worker refuses which one, why and since when, and whether a campaign has a worker left.

A refusal holds until its worker answers or is asked again, and is shown until another worker answers. An idle worker that refuses for long
is replaced, and a busy one is asked again: its installation may have been repaired. A refusal is disputed if the worker's tools have other
versions than the campaign began with, or none is known, or if the problem's files cannot be run anywhere.
"""

import logging
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field

from drivecal.contracts.work import BatchResult, SetupKey, SetupRequest
from drivecal.execution.scheduling.in_flight import WITNESSES

PATIENCE_WITH_REFUSALS = 30.0
"""Seconds after which a refusing worker is replaced, or asked again if it is busy."""
SHARE_OF_REFUSALS = 0.05
"""Largest share of a busy worker's time for setups that it refused: a refusal may take as long as a start."""
PATIENCE_WITH_ANSWERS = 60.0
"""Seconds with another answer and without an agreeing worker after which a campaign is hopeless. A worker that refuses is replaced after
half of it, and then runs the probe again."""
MOST_REASONS = 5
"""Different reasons of refusing workers in a message."""

log = logging.getLogger(__name__)


@dataclass(slots=True)
class _Refusal:
    reason: str
    since: float
    """Time of the first one in a row."""
    ask_at: float
    """Time from which a busy worker is asked again."""
    is_asked: bool = False
    """The worker may try again."""


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


class Refusals:
    """The refusals of all workers, by setup; None is the probe of any bundle."""

    def __init__(self) -> None:
        self.now = 0.0
        """The time (s)."""
        self._nodes: Mapping[str, str] = {}
        self._by_setup: dict[SetupKey | None, dict[str, _Refusal]] = {}
        self._disputes: dict[SetupKey, _Dispute] = {}

    def meet(self, nodes: Mapping[str, str], now: float) -> None:
        """Notes the nodes of the workers that have started, by worker, and the time (s)."""
        self._nodes, self.now = nodes, now

    def answered(self, setup: SetupRequest, result: BatchResult, *, is_wanted: bool) -> None:
        """Takes the result of a batch. After a withdrawal (`is_wanted`), a refusal says nothing about the next campaign."""
        self.note(result.worker, setup.key, result.refusal, 0.0 if result.results else result.seconds)
        if result.refusal is None:
            self._disputes.pop(setup.key, None)
        elif is_wanted and (setup.tools is not None or result.unsuitable):
            dispute = self._disputes.setdefault(setup.key, _Dispute())
            if result.unsuitable:
                dispute.unsuitable[result.worker] = f"no worker can run the scenario {setup.scenario}: {result.refusal}"
                dispute.nodes.add(self._nodes.get(result.worker, result.worker))
            dispute.refusals[result.worker] = result.refusal
            if result.tools is not None:
                dispute.differing.add(result.worker)
                dispute.since = self.now if dispute.since is None else dispute.since

    def note(self, worker: str, setup: SetupKey | None, reason: str | None, seconds: float = 0.0) -> None:
        """Notes that a worker refuses a setup or answers. `seconds`: the worker's time for the refusal, 0 if unknown."""
        refusing = self._by_setup.pop(setup, {})
        before = refusing.pop(worker, None)
        refusing = {name: refusal for name, refusal in refusing.items() if name in self._nodes}
        if reason is not None:
            since = self.now if before is None or before.is_asked else before.since
            if since == self.now:
                log.warning("%s refuses: %s", worker, reason)
            ask_at = self.now + max(PATIENCE_WITH_REFUSALS, seconds / SHARE_OF_REFUSALS)
            refusing[worker] = _Refusal(reason, since, ask_at)
        if refusing:
            self._by_setup[setup] = refusing

    def refusing(self, setup: SetupKey | None) -> Collection[str]:
        """Returns the workers that refused a setup, and were not asked again since."""
        return [worker for worker, refusal in self._by_setup.get(setup, {}).items() if not refusal.is_asked]

    def ask_busy(self, idle: Collection[str]) -> None:
        """Lets busy workers try setups again that they refused long ago. The reasons are shown until they answer. Idle workers are
        replaced, which finds more that was mended."""
        for setup, refusing in self._by_setup.items():
            for worker, refusal in refusing.items() if setup is not None else ():
                if worker in self._nodes and worker not in idle and self.now >= refusal.ask_at:
                    refusal.is_asked = True

    def is_overdue(self, worker: str, setups: Iterable[SetupKey | None]) -> bool:
        """Returns whether a worker has refused one of the setups for long."""
        kept_from = (self._by_setup[setup][worker] for setup in setups if worker in self.refusing(setup))
        return any(self.now >= refusal.since + PATIENCE_WITH_REFUSALS for refusal in kept_from)

    def reasons(self, setups: Collection[SetupKey]) -> dict[str, str]:
        """Returns the reasons of workers that refuse any of these setups."""
        listed = (refusing for setup, refusing in self._by_setup.items() if setup in setups)
        return {worker: refusal.reason for refusing in listed for worker, refusal in refusing.items()}

    @property
    def are_disputed(self) -> bool:
        """True if there are disputes."""
        return bool(self._disputes)

    def keep(self, setups: Collection[SetupKey]) -> None:
        """Drops the disputes of all other setups: no campaign waits for them."""
        self._disputes = {setup: dispute for setup, dispute in self._disputes.items() if setup in setups}

    def hopeless(self, setups: Collection[SetupKey]) -> str | None:
        """Returns the reasons why none of the workers will run one of these setups, or None.

        A second worker has to confirm that the problem's files are to blame, if there is one, and on a second node if there are several:
        the first may be damaged. A setup whose probe breaks at all workers is waited for: a licence server or a mount may come back.
        """
        ready = self._nodes
        workers, nodes = (min(WITNESSES, max(count, 1)) for count in (len(ready), len(set(ready.values()))))
        for setup in self._disputes.keys() & set(setups):
            dispute = self._disputes[setup]
            if len(dispute.unsuitable) >= workers and len(dispute.nodes) >= nodes:
                return "; ".join(dict.fromkeys(dispute.unsuitable.values()))
            if dispute.since is None or self.now < dispute.since + PATIENCE_WITH_ANSWERS:
                continue
            if dispute.differing & ready.keys() and dispute.refusals.keys() >= ready.keys():
                reasons = dict.fromkeys(dispute.refusals[worker] for worker in ready)
                return "; ".join(list(reasons)[:MOST_REASONS])
        return None
