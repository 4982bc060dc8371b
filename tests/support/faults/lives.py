"""The life of a server under faults: at points of its work that a seed chooses, something is done to it; then it has to go on."""

import random
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Protocol

import httpx
import psutil
from sqlalchemy import func, select
from tests.support.effort import LONG
from tests.support.faults.coordinator import ORPHAN_SECONDS, Coordinator, suspended
from tests.support.faults.findings import Found, assert_equal, assert_sound, found
from tests.support.faults.patience import Patience
from tests.support.faults.postgres import KillablePostgres
from tests.support.faults.workload import ANALYSING, Accepted, single_evaluations, submit
from tests.support.serve import TLS, alive

from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import DrivecalError
from drivecal.storage import campaigns
from drivecal.storage.engine.tables import campaigns as stored
from drivecal.storage.engine.tables import evaluations

LOOK_SECONDS = 0.1
"""Time between two checks, which take processor time from the server."""
SAID_SECONDS = 5.0
"""Longest time until the server reports a fault."""
ASLEEP_SECONDS = 20.0
PATIENCE_SECONDS = 120.0 if LONG else 400.0
"""Longest time until a server continues its work; it needs ten seconds."""


class Fault(Protocol):
    """Does something to a server; what it ended on purpose it starts again."""

    __name__: str

    def __call__(self, coordinator: Coordinator, /) -> None: ...


def kill_dispatcher(coordinator: Coordinator) -> None:
    """SIGKILL; nothing of it, such as its Ray, may stay behind, and the supervisor starts the next one."""
    _kill_child(coordinator, coordinator.dispatcher)


def kill_api(coordinator: Coordinator) -> None:
    """SIGKILL; the supervisor starts the next one."""
    _kill_child(coordinator, coordinator.api)


def kill_raylet(coordinator: Coordinator) -> None:
    """SIGKILL to the node's daemon of the local Ray, which takes the workers along."""
    _kill_child(coordinator, lambda: coordinator.ray_part("raylet"))


def kill_gcs_server(coordinator: Coordinator) -> None:
    """SIGKILL to the local Ray's store of cluster state."""
    _kill_child(coordinator, lambda: coordinator.ray_part("gcs_server"))


def _kill_child(coordinator: Coordinator, find: Callable[[], psutil.Process]) -> None:
    """Kills a process, waited for where it is just being started again; what it had started must end as well."""
    victim = coordinator.awaited(find)
    before = [victim]
    with suppress(psutil.NoSuchProcess):  # it may end by itself just now
        before += victim.children(recursive=True)
        victim.kill()
    coordinator.until(lambda: not any(alive(item) for item in before), f"the end of {before}", ORPHAN_SECONDS)


def kill_supervisor(coordinator: Coordinator) -> None:
    """SIGKILL to the process that was started; nothing may stay behind. Then it is started again."""
    coordinator.kill_supervisor()
    coordinator.start()


def kill_everything(coordinator: Coordinator) -> None:
    """SIGKILL to all processes at once, as when the machine goes down. Then the server is started again."""
    coordinator.kill_all()
    coordinator.start()


def terminate(coordinator: Coordinator) -> None:
    """SIGTERM under load: ends in time, leaves nothing behind, and is started again."""
    coordinator.terminate()
    coordinator.start()


def outage(postgres: KillablePostgres, seconds: float) -> Fault:
    """PostgreSQL is killed in the middle of a commit and comes back after this many seconds. Meanwhile the API lives, and says what is
    wrong."""

    def postgres_killed(coordinator: Coordinator) -> None:
        in_a_commit = postgres.kill_in_a_commit()
        begin = time.monotonic()
        postgres_killed.__name__ = f"kill_postgresql_{'in_a' if in_a_commit else 'outside_of_any'}_commit"
        print(f"         {postgres_killed.__name__}; down for {seconds:.1f} s", flush=True)
        if seconds >= SAID_SECONDS:
            assert_said(coordinator, "database")
            refused = httpx.post(f"{coordinator.url}/api/v1/campaigns", json=ANALYSING, timeout=35.0, verify=TLS)
            assert (refused.status_code, "Retry-After" in refused.headers) == (503, True), refused.text
            time.sleep(max(0.0, begin + seconds - time.monotonic()))
            health = coordinator.answers("/healthz")
            assert health is not None, "the API did not live through it"
            assert health.status_code == httpx.codes.OK
        time.sleep(max(0.0, begin + seconds - time.monotonic()))
        postgres.start()

    return postgres_killed


def assert_said(coordinator: Coordinator, word: str) -> None:
    """AssertionError where /readyz does not say within `SAID_SECONDS` that it is not ready, with `word` in the reason."""
    answers: list[httpx.Response] = []

    def said() -> bool:
        answers[:] = filter(None, [coordinator.answers("/readyz")])
        return any(answer.status_code != httpx.codes.OK and word in answer.text for answer in answers)

    took = coordinator.until(said, f"that /readyz names the {word}", SAID_SECONDS)
    print(f"         said after {took}: {answers[0].json()['problems']}", flush=True)


def asleep_for(seconds: float) -> Fault:
    """SIGSTOP to all its processes, and SIGCONT after this many seconds: a laptop that sleeps."""

    def asleep(coordinator: Coordinator) -> None:
        with suspended(coordinator.family()):
            time.sleep(seconds)

    return asleep


asleep = asleep_for(ASLEEP_SECONDS)


def dispatcher_asleep(coordinator: Coordinator) -> None:
    """SIGSTOP to the dispatcher alone, and SIGCONT after a while; the others see a dispatcher that says nothing until it is replaced."""
    with suspended([coordinator.dispatcher()]):
        ends, told = time.monotonic() + ASLEEP_SECONDS, list[str]()
        while time.monotonic() < ends:
            answer = coordinator.answers("/readyz")
            told += [] if answer is None else [answer.text]
            time.sleep(0.5)
    assert any("silent" in text for text in told), told


def and_ready_again(fault: Fault) -> Fault:
    """The fault, after which the server has to be ready in time, before the next one."""

    def both(coordinator: Coordinator) -> None:
        fault(coordinator)
        print(f"         ready again {coordinator.wait_ready()} after {fault.__name__}", flush=True)

    both.__name__ = fault.__name__
    return both


@dataclass(frozen=True)
class Moment:
    """When a fault happens: at a share of the campaigns' cells, or this many seconds after the last fault whatever was done by then."""

    share: float | None
    seconds: float


@dataclass
class Life:
    """Describes what happened: printed where a test fails, so that it can be repeated."""

    coordinator: Coordinator
    cells: int
    """Evaluations of the campaigns, all told: of their run without faults."""
    told: list[str] = field(default_factory=list)
    begin: float = field(default_factory=time.monotonic)
    faults: list[str] = field(default_factory=list)

    def strike(self, fault: Fault) -> None:
        """Has it happen."""
        fault(self.coordinator)
        self.faults.append(fault.__name__)  # what it has become

    def tell(self, words: str) -> None:
        """Notes what was done, and when."""
        line = f"{time.monotonic() - self.begin:6.1f} s: {words}"
        self.told.append(line)
        print(line, flush=True)

    def answered(self, accepted: Accepted) -> int | None:
        """Cells of the campaigns that have their answer; None while the database does not say."""
        try:
            with self.coordinator.database.read() as connection:
                sequences = [campaigns.get(connection, campaign).sequence for campaign in accepted.campaigns.values()]
                query = select(func.count()).where(
                    evaluations.c.outcome.is_not(None), evaluations.c.campaign_sequence.in_(sequences)
                )
                return connection.execute(query).scalar_one()
        except DrivecalError:
            return None

    def wait_for(self, moment: Moment, accepted: Accepted) -> int | None:
        """Waits for a moment; gives the cells answered by then."""
        since = time.monotonic()
        patience = Patience(PATIENCE_SECONDS, self.coordinator.family)
        if moment.share is not None:
            while (self.answered(accepted) or 0) < moment.share * self.cells:
                assert self.coordinator.running, f"the server ended by itself:\n{self.coordinator.told()}"
                assert not patience.over, f"no progress within {patience.told()}:\n{self.coordinator.told()}"
                time.sleep(LOOK_SECONDS)
            since = time.monotonic()
        time.sleep(max(0.0, since + moment.seconds - time.monotonic()))
        return self.answered(accepted)


def moments(seed: int, number: int) -> list[Moment]:
    """Random points of a life: most at a share of the work and up to a batch's time after it; every third at any second after the
    fault before, so that starting and taking up are hit as well."""
    chance = random.Random(seed)
    shares = sorted(chance.uniform(0.0, 0.95) for _ in range(number))
    return [
        Moment(None, chance.uniform(0.0, 8.0)) if chance.random() < 1 / 3 else Moment(share, chance.uniform(0.0, 0.3))
        for share in shares
    ]


def live(
    coordinator: Coordinator,
    plan: Sequence[tuple[Moment, Fault]],
    expected: dict[str, Found],
    documents: Mapping[str, Mapping[str, Any]] | None = None,
) -> Life:
    """Gives a server its work, the `documents` or the suite's campaigns, and does all of the plan to it; then the campaigns have to end as
    they do without faults, and the server has to leave nothing behind."""
    life = Life(coordinator, sum(len(item.tables["evaluations"]) for item in expected.values()))
    coordinator.start_ready()
    life.tell("ready")
    accepted = submit(coordinator.url, documents)
    with single_evaluations(coordinator.url, accepted):
        for moment, fault in plan:
            answered = life.wait_for(moment, accepted)
            life.tell(f"{fault.__name__} at {answered} of {life.cells} cells")
            life.strike(fault)
    life.tell(f"ready again {coordinator.wait_ready()} after the last fault")
    wait_until_ended(coordinator, accepted)
    life.tell(f"all has ended; {len(accepted.evaluations)} single evaluations were accepted")
    assert_as_without_faults(coordinator, accepted, expected)
    life.tell(f"SIGTERM ended it in {coordinator.terminate()}")
    return life


def wait_until_ended(coordinator: Coordinator, accepted: Accepted, seconds: float = PATIENCE_SECONDS) -> None:
    """Waits for the end of everything that was accepted."""

    def all_ended() -> bool:
        assert coordinator.running, f"the server ended by itself:\n{coordinator.told()}"
        return has_ended(coordinator, accepted)

    coordinator.until(all_ended, "the end of all that was accepted", seconds)


def has_ended(coordinator: Coordinator, accepted: Accepted) -> bool:
    """Returns whether everything that was accepted has ended; not, where the database does not say."""
    with suppress(DrivecalError), coordinator.database.read() as connection:
        identifiers = [*accepted.campaigns.values(), *(answers[0] for answers in accepted.evaluations.values())]
        if not all(campaigns.get(connection, identifier).state.ended for identifier in identifiers):
            return False
        others = select(func.count()).select_from(stored).where(stored.c.ended_at.is_(None))
        return connection.execute(others).scalar_one() == 0  # also those whose answer was lost
    return False


def assert_as_without_faults(coordinator: Coordinator, accepted: Accepted, expected: dict[str, Found]) -> None:
    """AssertionError where a campaign found anything else than in its run without faults, or anything was lost or done twice."""
    assert_sound(coordinator, accepted)
    for name, identifier in accepted.campaigns.items():
        assert_equal(name, found(coordinator, identifier), expected[name])
        assert expected[name].campaign["state"] == CampaignState.SUCCEEDED
