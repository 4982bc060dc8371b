"""Small campaigns next to far larger ones, or to far longer cells: simulated on virtual time, so that only work counts."""

from collections import Counter

import pytest
from tests.support.plant import Plant, cells

from drivecal.execution.scheduling.batching import BESIDE_SMALL_SECONDS, DISPATCH_SECONDS, TARGET_SECONDS

MANY = 2_500
"""Cells of the large campaign for each worker that wait at a time."""
SMALL = 100
"""Cells of a small campaign for each worker: ten times the work that workers hold when it comes."""
COST = {"S1": 0.05, "S2": 0.05}
GENERATIONS, POPULATION = 4, 12
WAIT = 2 * TARGET_SECONDS
"""Seconds that the cells of the first two generations wait at most for their first turn: for the running batch of a worker and the one
behind it, which are long if they were sent before the campaign came."""


def time_alone(workers: int, scenario: str, count: int, cost: dict[str, float]) -> float:
    """Seconds that a campaign takes on idle workers that know what its cells cost."""
    plant = warm(workers, cost)
    began = plant.now
    plant.add("small", scenario, cells(count, first=500_001))
    plant.run()
    return plant.now - began


def warm(workers: int, cost: dict[str, float]) -> Plant:
    """Workers that have measured every scenario."""
    plant = Plant(workers, cost)
    for number, scenario in enumerate(cost):
        plant.add("first", scenario, cells(2 * workers, first=900_001 + 1_000 * number))
    plant.run()
    return plant


def seconds_until_done(plant: Plant, tag: str) -> float:
    began = plant.now
    while plant.scheduler.held(tag) and plant.step():
        pass
    return plant.now - began


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2, 8])
def test_each_of_ten_small_campaigns_ends_in_three_times_its_time_alone_beside_a_large_one(workers: int) -> None:
    alone = time_alone(workers, "S2", SMALL * workers, COST)
    plant = warm(workers, COST)
    plant.add("large", "S1", cells(MANY * workers))
    plant.run(until=plant.now + 10.0)
    for number in range(10):
        tag = f"small {number}"
        plant.add(tag, "S2", cells(SMALL * workers, first=500_001 + 1_000 * number))
        assert seconds_until_done(plant, tag) <= 3 * alone
    assert plant.scheduler.held("large") > 0


def seconds_of_generations(plant: Plant, tag: str, first: int) -> float:
    """Seconds of a campaign that asks for its next generation once it has the answers of the last one."""
    began = plant.now
    for number in range(GENERATIONS):
        plant.add(tag, "S2", cells(POPULATION, first=first + POPULATION * number))
        seconds_until_done(plant, tag)
    return plant.now - began


def short(workers: int) -> float:
    """Returns the seconds of a batch while a small campaign runs: dispatching takes at most half of a core."""
    return max(BESIDE_SMALL_SECONDS, 2 * workers * DISPATCH_SECONDS)


@pytest.mark.faults("8-0", "8-100")
@pytest.mark.parametrize("before", [0, 100], ids=["0", "100"])
@pytest.mark.parametrize("workers", [1, 2, 8])
def test_a_small_campaign_in_generations_takes_little_more_than_three_times(workers: int, before: int) -> None:
    """Also if it had far more cells `before`, in an analysis for instance."""
    alone = seconds_of_generations(warm(workers, COST), "small", 500_001)
    plant = warm(workers, COST)
    plant.add("large", "S1", cells(2 * MANY * workers))
    plant.run(until=plant.now + 10.0)
    for number in range(10):
        tag, first = f"small {number}", 500_001 + 1_000 * number
        plant.add(tag, "S2", cells(before * workers, first=first + 100_000))
        seconds_until_done(plant, tag)
        assert seconds_of_generations(plant, tag, first) <= 3 * alone + 2 * WAIT + 2 * (GENERATIONS - 2) * short(workers)
        plant.scheduler.withdraw(tag)
        plant.run(until=plant.now + 1.0)
    assert plant.scheduler.held("large") > 0


def cells_of_batches(plant: Plant, tag: str) -> set[int]:
    """Numbers of cells of the batches that a campaign gets within four seconds."""
    before = len(plant.order)
    plant.run(until=plant.now + 4.0)
    return {count for whose, _, count in plant.order[before:] if whose == tag}


@pytest.mark.parametrize("workers", [1, 2, 8])
def test_batches_are_short_beside_a_small_campaign_only(workers: int) -> None:
    """A short batch costs the dispatcher as much as a long one."""
    long, brief = int(TARGET_SECONDS / COST["S1"]), int(short(workers) / COST["S1"])
    plant = warm(workers, COST)
    plant.scheduler.withdraw("first")
    plant.add("large", "S1", cells(MANY * workers))
    plant.add("as large", "S2", cells(MANY * workers, first=200_001))
    assert cells_of_batches(plant, "large") == {long}
    plant.add("small", "S2", cells(POPULATION, first=500_001))
    seconds_until_done(plant, "small")
    assert cells_of_batches(plant, "large") == {brief}
    plant.run(until=plant.now + 2.0)
    assert cells_of_batches(plant, "large") == {long}, "nothing of the small one for five seconds"
    plant.add("small", "S2", cells(POPULATION, first=600_001))
    seconds_until_done(plant, "small")
    plant.scheduler.withdraw("small")
    assert cells_of_batches(plant, "large") == {long}, "the small one has ended"


def test_small_campaigns_shorten_no_batches_of_each_other() -> None:
    """Else all batches of many equal campaigns would be short, and the dispatcher would have most to do of all."""
    plant = warm(1, COST)
    plant.scheduler.withdraw("first")
    for tag, first in (("small", 500_001), ("as small", 600_001)):
        plant.add(tag, "S2", cells(40, first=first))
    assert max(cells_of_batches(plant, "small")) == int(TARGET_SECONDS / COST["S2"])


def test_a_newcomer_waits_for_one_slow_cell_at_most() -> None:
    cost = {"fast": 0.01, "slow": 600.0}
    plant = warm(4, cost)
    plant.add("slow", "slow", cells(200))
    plant.run(until=plant.now + 1_000.0)
    plant.add("fast", "fast", cells(1_000, first=100_001))
    assert seconds_until_done(plant, "fast") <= 600.0 + 3 * time_alone(4, "fast", 1_000, cost)


SLOW = {"fast": 0.02, "slow": 600.0}


def running(plant: Plant) -> Counter[str]:
    """Workers that hold cells of each scenario."""
    return Counter(scenario for _, scenario in {(sent.worker, sent.batch.setup.scenario) for _, _, sent in plant._ends})


@pytest.mark.slow
@pytest.mark.faults("False-2", "False-7", "True-4", "True-7")
@pytest.mark.parametrize("workers", [2, 4, 7])
@pytest.mark.parametrize("measured", [False, True])
def test_slow_cells_hold_their_share_of_the_workers_beside_quick_ones(workers: int, measured: bool) -> None:
    plant = warm(workers, SLOW if measured else {"fast": SLOW["fast"]})
    plant.cost, plant.of_users = SLOW, True
    plant.add("fast", "fast", cells(40_000, first=100_001))
    plant.run(until=plant.now + 5.0)
    plant.add("slow", "slow", cells(200))
    while plant.scheduler.held("fast") > 1_000 and plant.step():
        assert running(plant)["slow"] <= workers // 2
        assert running(plant)["fast"] > 0
    assert running(plant)["slow"] > 0


@pytest.mark.slow
def test_slow_problems_of_many_scenarios_and_campaigns_leave_a_worker_to_quick_cells() -> None:
    plant = warm(4, {"fast": 0.02})
    plant.of_users = True
    plant.cost = {"fast": 0.02} | {f"slow {number}": 600.0 for number in range(8)}
    plant.add("fast", "fast", cells(40_000, first=100_001))
    plant.run(until=plant.now + 5.0)
    for number in range(8):
        plant.add(f"campaign {number}", f"slow {number}", cells(20, first=1 + 100 * number))
    began = plant.now
    assert seconds_until_done(plant, "fast") <= 40_000 * 0.02 + TARGET_SECONDS
    assert plant.now > began + 200.0, "slow cells had workers"


def test_a_quick_campaign_in_generations_waits_for_no_slow_cell() -> None:
    plant = warm(4, SLOW)
    plant.run(until=plant.now + 100.0)
    plant.add("quick", "fast", cells(12, first=500_001))
    plant.add("slow", "slow", cells(200))
    began = plant.now
    for number in range(1, 50):
        seconds_until_done(plant, "quick")
        plant.add("quick", "fast", cells(12, first=500_001 + 12 * number))
    seconds_until_done(plant, "quick")
    assert plant.now - began <= 50 * 12 * 0.02 + TARGET_SECONDS
    assert running(plant)["slow"] == 2


def test_slow_cells_take_every_worker_once_the_quick_campaign_is_over() -> None:
    plant = warm(4, SLOW)
    plant.add("quick", "fast", cells(12, first=500_001))
    plant.add("slow", "slow", cells(200))
    seconds_until_done(plant, "quick")
    plant.scheduler.withdraw("quick")
    plant.now += 10.0
    plant.fill()
    assert running(plant)["slow"] == 4


@pytest.mark.parametrize("priority", [0, 1])
def test_a_lower_priority_keeps_no_worker_from_slow_cells(priority: int) -> None:
    plant = warm(4, SLOW)
    plant.now += 10.0
    plant.add("quick", "fast", cells(1_000, first=500_001))
    plant.fill()
    plant.add("slow", "slow", cells(200), priority)
    most = 0
    while plant.scheduler.held("quick") > 200 and plant.step():
        most = max(most, running(plant)["slow"])
        if most == 4:
            break
    assert most == (4 if priority else 1), "of equal priority, the second waits until the quick campaign had its time"
