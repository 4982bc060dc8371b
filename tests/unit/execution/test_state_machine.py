"""A state machine that does to the scheduler whatever can happen to it, and knows what has to come of it.

It plays the campaigns, the database (leases, breakdowns that were written down), the workers and the clock.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule, run_state_machine_as_test
from tests.support.effort import tries
from tests.support.fake_backend import Behaviour
from tests.support.plant import answer
from tests.support.setups import bare as setup

from drivecal.contracts.work import BatchResult, Cell, CellResult
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import Lost
from drivecal.execution.scheduling.in_flight import WITNESSES, Completed, Dispatch, Work
from drivecal.execution.scheduling.scheduler import ATTEMPTS, Scheduler

STEPS = tries(1_500, 200_000)
TAGS = ("a", "b", "c")
PLACES = 3
DEADLINE, RESTART = 60.0, 1.6
"""Seconds that a batch may take, and that a new worker needs to start."""
POISON = {7: Behaviour.CRASH, 8: Behaviour.HANG, 9: Behaviour.ERROR, 10: Behaviour.MEMORY}
"""Behaviour by value of a parameter; cells with other values succeed."""


@dataclass
class Row:
    """A cell in the database."""

    id: int
    tag: str
    scenario: str
    value: int
    priority: int
    exclusive: bool
    breakdowns: int = 0
    """As written down."""
    withdrawn: bool = False

    @property
    def identity(self) -> Hashable:
        return self.id if self.exclusive else (self.scenario, self.value)


@dataclass
class Place:
    """A worker and its replacements."""

    number: int
    incarnation: int = 1
    ready_at: float = 0.0
    batches: list[Dispatch] = field(default_factory=list)
    deadline: float = 0.0
    """Deadline of the first batch."""

    @property
    def name(self) -> str:
        return f"worker-{self.number}.{self.incarnation}"


def broken_result(cell: Cell, breakdown: Breakdown) -> CellResult:
    return CellResult(cell.id, None, None, {}, None, 1.0, breakdown.value, "as asked for")


def assert_batch(sent: Dispatch, rows: Sequence[Row]) -> None:
    """AssertionError if a batch does not consist of what these rows ask for, each once and none in vain."""
    assert {row.id: row.value for row in rows} == {cell.id: cell.parameters["P1"] for cell in sent.batch.cells}
    assert not any(row.withdrawn for row in rows)
    assert {(row.tag, row.scenario, row.priority) for row in rows} == {
        (rows[0].tag, sent.batch.setup.scenario, rows[0].priority)
    }
    assert len({row.identity for row in rows}) == len(rows)
    if any(sent.breakdowns.values()):
        assert sent.alone
    if sent.alone:
        assert len(rows) == 1


class Turmoil(RuleBasedStateMachine):
    """`steps` is the number of steps in all examples."""

    steps = 0

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.scheduler = Scheduler()
        self.places = [Place(number) for number in range(PLACES)]
        self.rows: dict[int, Row] = {}
        self.paused: list[Row] = []
        self.tally: dict[Hashable, int] = {}
        self.witnesses: dict[Hashable, set[str]] = {}
        self.blamed: dict[Hashable, str] = {}
        """Whose doing the last breakdown of each identity was."""
        self.returned: list[tuple[Dispatch, BatchResult]] = []
        self.submitted = self.answered = self.given_up = 0
        self.since_restart = 0

    @rule(
        tag=st.sampled_from(TAGS),
        scenario=st.sampled_from(["S1", "S2"]),
        values=st.lists(st.integers(0, 40), min_size=1, max_size=20),
        priority=st.sampled_from([0, 0, 0, 1]),
        exclusive=st.sampled_from([False, False, False, True]),
    )
    def submit(self, tag: str, scenario: str, values: list[int], priority: int, exclusive: bool) -> None:
        first = self.submitted + 1
        self.submitted += len(values)
        self._add([Row(first + index, tag, scenario, value, priority, exclusive) for index, value in enumerate(values)])

    @rule(data=st.data())
    def dispatch(self, data: st.DataObject) -> None:
        """Leases what there is room for, which may fail in whole or in part, and sends it."""
        for place in self._ready():
            while (sent := self._next(place)) is not None:
                match data.draw(st.sampled_from(["granted"] * 4 + ["unavailable", "partly"])):
                    case "unavailable":
                        self.scheduler.take_back(sent.batch_id)
                        break
                    case "partly":
                        numbers = [cell.id for cell in sent.batch.cells]
                        self._drop(place, sent, set(numbers[data.draw(st.integers(0, len(numbers))) :]))
                    case _:
                        self._send(place, sent)

    @precondition(lambda self: self._busy())
    @rule(data=st.data(), seconds=st.sampled_from([0.0001, 0.001, 0.5]))
    def finish(self, data: st.DataObject, seconds: float) -> None:
        """Ends the first batch of a worker as its cells behave; a hanging batch continues."""
        self._end_first(data.draw(st.sampled_from(self._busy())), seconds)

    @rule(rounds=st.integers(1, 8))
    def work(self, rounds: int) -> None:
        """For a while all goes well, but for what the cells do themselves."""
        for _ in range(rounds):
            self._send_all()
            for place in self._busy():
                self._end_first(place, 0.0001 * len(place.batches[0].batch.cells))

    @precondition(lambda self: self._busy())
    @rule()
    def expire(self) -> None:
        """The clock passes the next deadline: the worker is ended."""
        place = min(self._busy(), key=lambda one: one.deadline)
        self.now = max(self.now, place.deadline)
        hung = self._first(place, Behaviour.HANG)
        self._lose(place, Breakdown.HANG, hung)

    @precondition(lambda self: self._busy())
    @rule(data=st.data())
    def kill(self, data: st.DataObject) -> None:
        """Kills a worker from outside."""
        self._lose(data.draw(st.sampled_from(self._busy())), Breakdown.CRASH, None)

    @precondition(lambda self: self._busy())
    @rule(data=st.data(), unreadable=st.booleans())
    def spoil(self, data: st.DataObject, unreadable: bool) -> None:
        """A worker answers every cell with an error, or sends an unreadable answer."""
        place = data.draw(st.sampled_from(self._busy()))
        sent = self._take_first(place)
        if unreadable:
            completed = self.scheduler.lost(Lost(sent.batch_id, place.name, Breakdown.ERROR, "it speaks in tongues"))
        else:
            results = tuple(broken_result(cell, Breakdown.ERROR) for cell in sent.batch.cells)
            completed = self.scheduler.finished(sent.batch_id, BatchResult(place.name, results, 0.1))
        self._settle(sent, completed, {cell.id: (Breakdown.ERROR, "outside") for cell in sent.batch.cells}, place.name)

    @precondition(lambda self: self._busy())
    @rule(data=st.data())
    def refuse(self, data: st.DataObject) -> None:
        """A worker cannot run a setup."""
        place = data.draw(st.sampled_from(self._busy()))
        sent = self._take_first(place)
        assert self.scheduler.finished(sent.batch_id, BatchResult(place.name, (), 0.1, "it has another version")) == []
        self._forget_withdrawn(sent)

    @precondition(lambda self: any(len(place.batches) > 1 for place in self.places))
    @rule(data=st.data())
    def give_back(self, data: st.DataObject) -> None:
        """A worker gives back what waits behind a run that takes longer than expected."""
        place = data.draw(st.sampled_from([place for place in self.places if len(place.batches) > 1]))
        sent = place.batches.pop()
        assert self.scheduler.lost(Lost(sent.batch_id, place.name, Breakdown.ERROR, "it was busy", 0.0, begun=False)) == []
        self._forget_withdrawn(sent)

    @precondition(lambda self: self.returned)
    @rule(data=st.data())
    def answer_late(self, data: st.DataObject) -> None:
        """The result of a batch that was lost, or came back before, changes nothing."""
        sent, result = data.draw(st.sampled_from(self.returned))
        assert self.scheduler.finished(sent.batch_id, result) == []
        assert self.scheduler.lost(Lost(sent.batch_id, sent.worker, Breakdown.CRASH, "it died long ago")) == []

    @rule(tag=st.sampled_from(TAGS), pause=st.booleans())
    def withdraw(self, tag: str, pause: bool) -> None:
        """A campaign is paused or cancelled."""
        at_workers = self._at_workers()
        running = [row for row in self.rows.values() if row.tag == tag and row.id in at_workers]
        assert self.scheduler.withdraw(tag) == len(running)
        for row in [row for row in self.rows.values() if row.tag == tag]:
            if row.id in at_workers:
                row.withdrawn = True
            else:
                self._give_up(row)
                if pause:
                    self.paused.append(row)

    @precondition(lambda self: any(not self.scheduler.held(row.tag) for row in self.paused))
    @rule()
    def resume(self) -> None:
        """Resumes a paused campaign once no worker holds its cells."""
        tag = next(row.tag for row in self.paused if not self.scheduler.held(row.tag))
        back = [row for row in self.paused if row.tag == tag]
        self.paused = [row for row in self.paused if row.tag != tag]
        self.given_up -= len(back)
        self._add(back)

    @precondition(lambda self: self.since_restart > 12)
    @rule()
    def restart(self) -> None:
        """The dispatcher dies and takes its workers along. The next one reads what was written down."""
        self.since_restart = 0
        self.scheduler = Scheduler()
        self.returned.clear()
        for place in self.places:
            place.batches.clear()
            self._replace(place)
        rows = list(self.rows.values())
        self.rows.clear()
        self.tally.clear()
        self.witnesses.clear()
        self.given_up += sum(row.withdrawn for row in rows)
        self._add([row for row in rows if not row.withdrawn])

    @rule(seconds=st.floats(0.0, 5.0))
    def wait(self, seconds: float) -> None:
        """Workers that were replaced start meanwhile."""
        self.now += seconds

    @invariant()
    def every_cell_is_somewhere(self) -> None:
        type(self).steps += 1
        self.since_restart += 1
        assert self.submitted == len(self.rows) + self.answered + self.given_up
        for tag in TAGS:
            assert self.scheduler.held(tag) == sum(row.tag == tag for row in self.rows.values())

    def teardown(self) -> None:
        """Nothing more happens from outside: everything has to come to its end."""
        for _ in range(20_000):
            if not self.rows:
                return
            self._send_all()
            if not self._busy():  # everybody is starting, or refused what there is to do: a new process has another version
                for place in self._ready():
                    self._replace(place)
                self.now += RESTART
                continue
            place = self._busy()[0]
            if not self._end_first(place, 0.01):
                self.now = place.deadline
                self._lose(place, Breakdown.HANG, self._first(place, Behaviour.HANG))
        raise AssertionError(f"never answered: {sorted(self.rows)}")

    # What the machine plays.

    def _add(self, rows: list[Row]) -> None:
        groups: dict[tuple[str, str, int, bool], list[Row]] = {}
        for row in rows:
            groups.setdefault((row.tag, row.scenario, row.priority, row.exclusive), []).append(row)
        for (tag, scenario, priority, exclusive), group in groups.items():
            cells = [Cell(row.id, {"P1": float(row.value)}) for row in group]
            earlier = {row.id: row.breakdowns for row in group if row.breakdowns}
            self.scheduler.add(Work(setup(scenario), cells, exclusive=exclusive, breakdowns=earlier), tag, priority)
            for row in group:
                row.withdrawn = False
                self.rows[row.id] = row
                self.tally[row.identity] = max(self.tally.get(row.identity, 0), row.breakdowns)

    def _ready(self) -> list[Place]:
        ready = [place for place in self.places if place.ready_at <= self.now]
        self.scheduler.meet([place.name for place in ready])
        return ready

    def _busy(self) -> list[Place]:
        return [place for place in self.places if place.batches]

    def _at_workers(self) -> set[int]:
        return {cell.id for place in self.places for sent in place.batches for cell in sent.batch.cells}

    def _next(self, place: Place) -> Dispatch | None:
        """Returns the next batch if the worker has room; replaces the worker if the scheduler wants it."""
        if len(place.batches) == 2 or any(batch.alone for batch in place.batches):
            return None
        sent = self.scheduler.next_batch(place.name, idle=not place.batches)
        if sent is not None:
            self._check_dispatch(place, sent)
        elif not place.batches and (self.scheduler.fault(place.name) or self.scheduler.is_stuck(place.name)):
            self._replace(place)
        return sent

    def _send_all(self) -> None:
        for place in self._ready():
            while (sent := self._next(place)) is not None:
                self._send(place, sent)

    def _check_dispatch(self, place: Place, sent: Dispatch) -> None:
        rows = [self.rows[cell.id] for cell in sent.batch.cells]
        assert_batch(sent, rows)
        running = {self.rows[number].identity for number in self._at_workers()}
        assert running.isdisjoint(row.identity for row in rows), "it is simulated already"
        assert dict(sent.breakdowns) == {row.id: self.tally[row.identity] for row in rows}
        assert not (sent.alone and place.batches)

    def _drop(self, place: Place, sent: Dispatch, answered: set[int]) -> None:
        rest = self.scheduler.drop(sent.batch_id, answered)
        for number in answered:
            self._give_up(self.rows[number])
        assert (rest is None) == (len(answered) == len(sent.batch.cells))
        if rest is not None:
            assert [cell.id for cell in rest.batch.cells] == [cell.id for cell in sent.batch.cells if cell.id not in answered]
            self._send(place, rest)

    def _send(self, place: Place, sent: Dispatch) -> None:
        place.batches.append(sent)
        if len(place.batches) == 1:
            place.deadline = self.now + DEADLINE

    def _take_first(self, place: Place) -> Dispatch:
        sent = place.batches.pop(0)
        place.deadline = self.now + DEADLINE
        self.returned.append((sent, BatchResult(sent.worker, tuple(map(answer, sent.batch.cells)), 0.1)))
        return sent

    def _first(self, place: Place, *kinds: Behaviour) -> int | None:
        """The first cell of the worker's first batch that behaves so."""
        cells = place.batches[0].batch.cells
        return next((cell.id for cell in cells if POISON.get(self.rows[cell.id].value) in kinds), None)

    def _end_first(self, place: Place, seconds: float) -> bool:
        poison = self._first(place, Behaviour.CRASH, Behaviour.HANG)
        if poison is not None:
            if POISON[self.rows[poison].value] is Behaviour.HANG:
                return False
            self._lose(place, Breakdown.CRASH, poison)
            return True
        sent = self._take_first(place)
        kinds = {Behaviour.ERROR: Breakdown.ERROR, Behaviour.MEMORY: Breakdown.MEMORY}
        broken = {
            cell.id: (kinds[POISON[self.rows[cell.id].value]], "itself")
            for cell in sent.batch.cells
            if self.rows[cell.id].value in POISON
        }
        results = tuple(broken_result(row, broken[row.id][0]) if row.id in broken else answer(row) for row in sent.batch.cells)
        completed = self.scheduler.finished(sent.batch_id, BatchResult(place.name, results, seconds))
        self._settle(sent, completed, broken, place.name)
        return True

    def _lose(self, place: Place, breakdown: Breakdown, poison: int | None) -> None:
        """Loses a worker with all its batches, because of the cell `poison` or, if None, from outside."""
        name = place.name
        while place.batches:
            sent = self._take_first(place)
            completed = self.scheduler.lost(Lost(sent.batch_id, name, breakdown, "it died", seconds=1.0))
            blame = {
                cell.id: (breakdown, "outside" if poison is None else "itself" if cell.id == poison else "a neighbour")
                for cell in sent.batch.cells
            }
            self._settle(sent, completed, blame, None)
        self._replace(place)

    def _replace(self, place: Place) -> None:
        place.incarnation += 1
        place.ready_at = self.now + RESTART

    def _settle(
        self, sent: Dispatch, completed: list[Completed], broken: dict[int, tuple[Breakdown, str]], witness: str | None
    ) -> None:
        """Compares what is completed with what has to be, and writes it down. `witness`: the worker, where it lives."""
        result = {item.result.id: item for item in completed}
        assert len(result) == len(completed), "a cell is completed twice"
        for cell in sent.batch.cells:
            row = self.rows[cell.id]
            alike = [element for element in self.rows.values() if element.identity == row.identity and element is not row]
            breakdown, culprit = broken.get(cell.id, (None, ""))
            attempts = self.tally[row.identity] + 1
            if breakdown is not None:
                self._note_breakdown(row, culprit, sent, witness)
                attempts = self.tally[row.identity]
                witnessed = breakdown is Breakdown.ERROR and len(self.witnesses.get(row.identity, ())) >= WITNESSES
                if attempts < ATTEMPTS and not witnessed:
                    if row.withdrawn:
                        self._give_up(row)
                    continue
                self._check_failure(row)
            assert attempts <= ATTEMPTS
            for entry in (row, *alike):
                done = result.pop(entry.id)
                assert (done.tag, done.attempts, done.worker) == (entry.tag, attempts, sent.worker)
                assert done.shared is (entry is not row)
                assert done.result.breakdown == (None if breakdown is None else breakdown.value)
                assert done.result.rating == (float(entry.value) if breakdown is None else None)
                del self.rows[entry.id]
                self.answered += 1
            self._forget_identity(row.identity)
        assert not result, "completed, but never sent, or not due"
        told = self.scheduler.take_breakdowns()
        expected = {row.id: self.tally[row.identity] for row in self.rows.values()}
        for number, count in told.items():
            assert count == expected[number] < ATTEMPTS
            self.rows[number].breakdowns = count
        for cell in sent.batch.cells:
            if cell.id in self.rows:
                assert self.rows[cell.id].breakdowns == expected[cell.id], "it was not told"

    def _note_breakdown(self, row: Row, culprit: str, sent: Dispatch, witness: str | None) -> None:
        most = ATTEMPTS if sent.alone else ATTEMPTS - 1
        self.tally[row.identity] = min(self.tally[row.identity] + 1, most)
        self.blamed[row.identity] = culprit
        if witness is not None:
            self.witnesses.setdefault(row.identity, set()).add(witness)

    def _check_failure(self, row: Row) -> None:
        """A cell fails by itself, or because faults from outside took all its attempts; never because of a neighbour."""
        assert self.blamed[row.identity] in ({"itself", "outside"} if row.value in POISON else {"outside"})

    def _forget_withdrawn(self, sent: Dispatch) -> None:
        for cell in sent.batch.cells:
            if self.rows[cell.id].withdrawn:
                self._give_up(self.rows[cell.id])

    def _give_up(self, row: Row) -> None:
        del self.rows[row.id]
        self.given_up += 1
        if not any(item.identity == row.identity for item in self.rows.values()):
            self._forget_identity(row.identity)

    def _forget_identity(self, identity: Hashable) -> None:
        for known in (self.tally, self.witnesses, self.blamed):
            known.pop(identity, None)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_every_cell_is_answered_once_or_withdrawn_whatever_happens() -> None:
    each = 50
    machines = settings(
        max_examples=STEPS // each * 3 // 2,  # some end earlier
        stateful_step_count=each,
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow],
    )
    run_state_machine_as_test(Turmoil, settings=machines)
    assert Turmoil.steps >= STEPS
