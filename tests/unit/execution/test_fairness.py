"""Whose turn it is: priorities, worker time, and the setups within a campaign."""

from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.support.plant import Plant, answers, cells, send
from tests.support.setups import bare as setup

from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import Lost
from drivecal.execution.scheduling.batching import TARGET_SECONDS, CellCosts
from drivecal.execution.scheduling.in_flight import Work
from drivecal.execution.scheduling.scheduler import Scheduler


def test_a_lower_priority_gets_nothing_while_a_higher_one_waits() -> None:
    plant = Plant(3)
    plant.add("low", "S1", cells(2000))
    plant.add("high", "S1", cells(2000, first=10_001), priority=2)
    plant.add("middle", "S1", cells(2000, first=20_001), priority=1)
    plant.run()
    order = [tag for tag, _, _ in plant.order]
    assert order == sorted(order, key=["high", "middle", "low"].index)


def test_campaigns_of_equal_priority_share_the_workers_time_and_not_their_batches() -> None:
    plant = Plant(2, {"cheap": 0.02, "dear": 3.8})
    plant.add("a", "cheap", cells(5000))
    plant.add("b", "dear", cells(100, first=200_001))
    plant.run(until=60.0)
    assert plant.given["a"] == pytest.approx(plant.given["b"], rel=0.05)
    batches = Counter(tag for tag, _, _ in plant.order)
    assert batches["a"] > 5 * batches["b"]


@pytest.mark.parametrize("before", [0, 10])
def test_a_campaign_that_asked_for_nothing_neither_makes_up_for_it_nor_waits_until_others_had_theirs(before: int) -> None:
    plant = Plant(2, {"S1": 0.05})
    if before:
        plant.add("lazy", "S1", cells(before))
    plant.add("busy", "S1", cells(6000, first=100_001))
    plant.run(until=100.0)
    given = dict(plant.given)
    plant.add("lazy", "S1", cells(1000, first=200_001))
    plant.run(until=120.0)
    assert plant.given["lazy"] - given.get("lazy", 0.0) == pytest.approx(20.0, abs=3 * TARGET_SECONDS)
    assert plant.given["busy"] - given["busy"] == pytest.approx(20.0, abs=3 * TARGET_SECONDS)


def test_a_campaign_whose_cells_hang_pays_for_the_time_that_they_take() -> None:
    scheduler = Scheduler()
    scheduler.meet(["w"])
    scheduler.add(Work(setup("S1"), cells(10)), "hangs", 0)
    scheduler.add(Work(setup("S2"), cells(1000, first=101)), "good", 0)
    time = {"hangs": 0.0, "good": 0.0}
    while time["good"] < 170.0:
        sent = scheduler.next_batch("w", idle=True)
        assert sent is not None
        if sent.batch.setup.scenario == "S1":
            time["hangs"] += 60.0
            scheduler.lost(Lost(sent.batch_id, "w", Breakdown.HANG, "it hung", 60.0))
        else:
            time["good"] += len(sent.batch.cells)
            scheduler.finished(sent.batch_id, answers(sent, float(len(sent.batch.cells))))
    assert time["hangs"] <= 240.0


def test_a_campaign_whose_batches_end_in_refusals_pays_for_the_results_before_them() -> None:
    scheduler = Scheduler()
    scheduler.meet(["w"])
    scheduler.add(Work(setup("S1"), cells(1000)), "refused", 0)
    scheduler.add(Work(setup("S2"), cells(1000, first=1001)), "good", 0)
    seconds = {"S1": 0.0, "S2": 0.0}
    while seconds["S2"] < 10.0:
        sent = send(scheduler, "w")
        scenario, result = sent.batch.setup.scenario, answers(sent, 1.0)
        seconds[scenario] += 1.0
        if scenario == "S1":
            result = replace(result, results=result.results[:1], refusal="no licence")
        scheduler.finished(sent.batch_id, result)
        scheduler.refusals.note("w", setup("S1").key, None)
    assert seconds["S1"] <= 11.0


@pytest.mark.faults("1-2", "1-7", "3-1", "3-2", "3-16")
@pytest.mark.parametrize("workers", [1, 2, 7, 16])
@pytest.mark.parametrize("tags", [1, 3])
def test_workers_finish_together_over_all_setups_and_campaigns(workers: int, tags: int) -> None:
    cost = {"S1": 0.0071, "S2": 0.0043, "S3": 0.03, "S4": 0.11}
    plant = Plant(workers, cost)
    work = 0.0
    for tag in range(tags):
        for number, scenario in enumerate(cost):
            count = (100, 400, 60, 20)[number] * workers
            plant.add(f"campaign {tag}", scenario, cells(count, first=1 + 1_000_000 * tag + 100_000 * number))
            work += count * cost[scenario]
    plant.run()
    assert work / (plant.now * workers) >= 0.97


def test_setups_that_were_never_measured_count_as_the_average_of_those_that_were() -> None:
    costs = CellCosts()
    one, other, third = (setup(scenario).key for scenario in ("S1", "S2", "S3"))
    assert costs.seconds({one: 10}) == 0.0
    costs.observe(one, 10, 1.0)
    costs.observe(other, 10, 3.0)
    assert costs.seconds({one: 10, other: 10, third: 10}) == pytest.approx(1.0 + 3.0 + 2.0)
    assert costs.seconds({third: 10}) == 0.0


def test_a_setup_in_a_vehicle_that_was_never_driven_costs_what_others_of_its_kind_do() -> None:
    costs, known, other = (
        CellCosts(),
        replace(setup("S1"), varied={"mass": 1800.0}),
        replace(setup("S2"), document={"scenario": "S2"}),
    )
    vehicle = replace(known, run_fingerprint="another", varied={"mass": 2000.0})
    for item in (known, vehicle, other):
        costs.relate(item.key, item.kind)
    assert costs.seconds_per_cell(vehicle.key) is None
    costs.observe(known.key, 10, 1.0)
    assert costs.seconds_per_cell(vehicle.key) == pytest.approx(0.1)
    assert costs.seconds_per_cell(other.key) is None
    costs.observe(vehicle.key, 10, 3.0)
    assert costs.seconds_per_cell(vehicle.key) == pytest.approx(0.3), "its own measurement counts more"


_costs = st.fixed_dictionaries({scenario: st.floats(0.0005, 0.6) for scenario in ("S1", "S2", "S3")})


@settings(max_examples=examples(25), deadline=None)
@example(3, {"S1": 0.5, "S2": 0.5, "S3": 0.001}, ["S1", "S3", "S3"], 2)
@example(3, {"S1": 0.0005, "S2": 0.5, "S3": 0.001}, ["S1", "S1", "S2"], 2)
@given(st.integers(1, 6), _costs, st.lists(st.sampled_from(["S1", "S2", "S3"]), min_size=2, max_size=4), st.integers(2, 4))
def test_waiting_campaigns_differ_by_one_batch(workers: int, cost: dict[str, float], scenarios: list[str], tags: int) -> None:
    assume(tags <= len(scenarios))
    plant = Plant(workers, cost)
    for number, scenario in enumerate(dict.fromkeys(scenarios)):  # so that every cost is known
        plant.add("first", scenario, cells(1, first=1 + number))
    plant.run()
    plant.scheduler.withdraw("first")
    names = [f"campaign {number}" for number in range(tags)]
    supply = dict.fromkeys(names, 0.0)
    for number, name in enumerate(names):
        for position in range(2):
            scenario = scenarios[(number + position) % len(scenarios)]
            enough = 30 * min(64, int(TARGET_SECONDS / cost[scenario]) + 1)  # batches and more
            supply[name] += enough * cost[scenario]
            plant.add(name, scenario, cells(enough, first=100_001 + 10_000 * number + 4000 * position))
    longest = max(TARGET_SECONDS, *cost.values()) + 1e-9
    for _ in range(40):
        plant.step()
        if any(plant.given[name] > supply[name] - workers * longest for name in names):
            break  # a campaign without waiting cells falls behind
        times = [plant.given[name] for name in names]
        assert max(times) - min(times) <= longest
