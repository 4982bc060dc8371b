"""Licences and other scarce things that runs hold: counted, never more at once than there are. Pure.

A worker holds the resources of a session while batches of its setups are there. A program that stays open between its runs holds them on:
its worker closes it before it takes another, or after `KEPT_SECONDS` without a run. Runs of a worker that is gone may go on for a while,
so that its resources settle first. A simulator that is busy itself is asked again after a pause, by worker.
"""

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from drivecal.contracts.inventory import ResourceAnswer
from drivecal.contracts.work import SetupKey, SetupRequest

KEPT_SECONDS = 3.0
"""Time without a run after which a program is closed that holds resources."""
FIRST_PAUSE, LONGEST_PAUSE = 1.0, 16.0
"""Pause (s) after a simulator was busy; it doubles up to the longest."""


@dataclass(slots=True)
class _Hold:
    """Resources of a session that a worker holds. `setup`: its first setup. `since`: time of its last batch; `batches` are there."""

    setup: SetupRequest
    batches: int = 0
    since: float = 0.0
    closing: bool = False


@dataclass(frozen=True, slots=True)
class _Pause:
    seconds: float
    until: float
    reason: str


class Resources:
    """The resources that workers hold.

    `settle_seconds`: longest time for which a run outlives its worker; `free_at`: end of the runs of an earlier dispatcher.
    """

    def __init__(self, total: Mapping[str, int], settle_seconds: float = 0.0, free_at: float = 0.0) -> None:
        self.total = dict(total)
        self._settle_seconds = settle_seconds
        self._now = 0.0
        self._holds: dict[str, dict[SetupKey, _Hold]] = {}
        self._settling: list[tuple[float, Mapping[str, int]]] = [(free_at, self.total)] if total else []
        self._pauses: dict[tuple[str, SetupKey], _Pause] = {}
        self.kept_back: set[str] = set()
        """Resources that an earlier campaign waits for; others may not start with them."""

    def meet(self, ready: Collection[str], now: float) -> None:
        """Notes which workers live, and the time (s)."""
        self._now = now
        for worker in self._holds.keys() - set(ready):
            self.leave(worker)
        self._settling = [(until, counts) for until, counts in self._settling if until > now]
        if self._pauses:
            self._pauses = {place: pause for place, pause in self._pauses.items() if place[0] in ready}

    def may_start(self, worker: str, setup: SetupRequest) -> bool:
        """Returns whether a worker may run a setup once it has closed its others: enough is free, and the simulator's pause is over."""
        if self._pauses_at(worker, setup) or self.kept_back & setup.resources.keys():
            return False
        if not setup.resources or setup.session_key in self._holds.get(worker, ()):
            return True
        own = Counter[str]()
        for hold in self._holds.get(worker, {}).values():
            own.update(hold.setup.resources)
        taken = self._taken()
        return all(taken[name] - own[name] + count <= self.total.get(name, 0) for name, count in setup.resources.items())

    def _pauses_at(self, worker: str, setup: SetupRequest) -> bool:
        pause = self._pauses.get((worker, setup.session_key))
        return pause is not None and pause.until > self._now

    def keep_back(self, worker: str, setup: SetupRequest) -> None:
        """Keeps the resources that a waiting setup lacks for it, unless its simulator pauses or too few exist."""
        wanted, taken = setup.resources, self._taken()
        if not self._pauses_at(worker, setup) and all(count <= self.total.get(name, 0) for name, count in wanted.items()):
            self.kept_back |= {name for name, count in wanted.items() if taken[name] + count > self.total[name]}

    def may_queue(self, worker: str, setup: SetupRequest) -> bool:
        """Returns whether a batch may wait behind another at a worker: it neither holds resources meanwhile nor delays their release."""
        holds = self._holds.get(worker, {})
        if any(key != setup.session_key and hold.setup.keeps_resources for key, hold in holds.items()):
            return False
        return not setup.resources or setup.session_key in holds

    def to_close(self, worker: str, chosen: SetupRequest | None) -> SetupRequest | None:
        """Returns a setup to close at an idle worker, before it runs the `chosen` one, or because it was unused for long or another
        campaign lacks its resources."""
        for key, hold in self._holds.get(worker, {}).items():
            unused = not hold.batches and not hold.closing
            is_over = self._now >= hold.since + KEPT_SECONDS or bool(self.kept_back & hold.setup.resources.keys())
            if unused and (is_over if chosen is None else key != chosen.session_key):
                return hold.setup
        return None

    def take(self, worker: str, setup: SetupRequest) -> None:
        """Notes a batch at a worker, for which `may_start` was True."""
        if setup.resources:
            self._holds.setdefault(worker, {}).setdefault(setup.session_key, _Hold(setup)).batches += 1

    def close(self, worker: str, setup: SetupRequest) -> None:
        """Notes that a worker is asked to close a setup."""
        self._holds[worker][setup.session_key].closing = True

    def closed(self, worker: str, setup: SetupRequest, *, done: bool) -> None:
        """Notes the answer of a worker that was asked to close a setup. A batch that was sent meanwhile has opened it again."""
        hold = self._holds.get(worker, {}).get(setup.session_key)
        if hold is not None:
            hold.closing, hold.since = False, self._now
            if done and not hold.batches:
                del self._holds[worker][setup.session_key]

    def end(self, worker: str, setup: SetupRequest, *, closed: bool = False) -> None:
        """Notes that a batch has come back, or was not sent. `closed`: the worker has nothing of the setup open."""
        hold = self._holds.get(worker, {}).get(setup.session_key)
        if hold is None:
            return
        hold.batches, hold.since = hold.batches - 1, self._now
        if not hold.batches and (closed or not hold.setup.keeps_resources):
            del self._holds[worker][setup.session_key]

    def leave(self, worker: str) -> None:
        """Notes that a worker is gone, whose runs may go on for a while."""
        for hold in self._holds.pop(worker, {}).values():
            self._settling.append((self._now + self._settle_seconds, hold.setup.resources))

    def note(self, worker: str, setup: SetupRequest, busy: str | None) -> None:
        """Notes that a simulator is busy for a reason, or that it has answered."""
        before = self._pauses.pop((worker, setup.session_key), None)
        if busy is not None:
            seconds = FIRST_PAUSE if before is None else min(2 * before.seconds, LONGEST_PAUSE)
            self._pauses[worker, setup.session_key] = _Pause(seconds, self._now + seconds, busy)

    def why(self, setup: SetupRequest) -> str | None:
        """Returns why cells of a setup wait, None if neither resources nor a busy simulator keep them."""
        taken = self._taken()
        for name, count in setup.resources.items():
            total = self.total.get(name, 0)
            if count > total:
                return f"it needs {count} {name}, and the server has {total} (drivecal serve --resources {name}={count})"
            if taken[name] + count > total:
                settling = sum(counts.get(name, 0) for _, counts in self._settling)
                late = f", {settling} of them by runs of workers that are gone, which may go on for a while" if settling else ""
                return f"{taken[name]} of {total} {name} are in use{late}"
        reasons = [pause.reason for place, pause in self._pauses.items() if place[1] == setup.session_key]
        return f"the simulator is busy: {reasons[-1]}" if reasons else None

    def use(self) -> list[ResourceAnswer]:
        """Returns the use of each resource."""
        taken, settling = self._taken(), Counter[str]()
        for _, counts in self._settling:
            settling.update(counts)
        return [
            ResourceAnswer(name=name, total=total, held=taken[name], settling=settling[name])
            for name, total in self.total.items()
        ]

    def _taken(self) -> Counter[str]:
        taken = Counter[str]()
        for counts in (hold.setup.resources for holds in self._holds.values() for hold in holds.values()):
            taken.update(counts)
        for _, counts in self._settling:
            taken.update(counts)
        return taken
