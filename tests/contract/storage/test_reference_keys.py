import random
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from tests.support.effort import tries
from tests.support.storage import EVALUATOR, new_run, setup_id

from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Donor
from drivecal.domain.influence import Influence, InfluenceMap
from drivecal.domain.parameters import ParameterSet
from drivecal.domain.values import decimal
from drivecal.reduction.keys import ReferenceKeys, billionths_matrix
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets, reference_keys, runs
from drivecal.storage.references.runs import NewRun

MAP = InfluenceMap(
    {"S1": {"P1": Influence(influential=True, lower=decimal("0.3"), upper=decimal("0.5")), "P2": Influence(influential=False)}}
)
STAGES = {StageName.SENSITIVITY: 0, StageName.CALIBRATION: 1, StageName.ROBUSTNESS: 2, StageName.VALIDATION: 3}


def keys_of(names: tuple[str, ...], values: npt.NDArray[np.int64]) -> list[bytes]:
    return ReferenceKeys(MAP, "S1", names).keys(values)


def keys_of_sets(sets: Sequence[ParameterSet]) -> list[bytes]:
    return keys_of(sets[0].names, billionths_matrix(sets))


def origin(run: NewRun) -> tuple[int, int, int, int]:
    return run.campaign_sequence, STAGES[run.stage], run.iteration, run.individual


def random_runs(chance: random.Random, count: int, setup: int, set_ids: Sequence[int]) -> list[NewRun]:
    """Runs with different sets and origins, in an order that has nothing to do with their origins."""
    origins = chance.sample([(c, s, i, n) for c in (1, 2, 3) for s in STAGES for i in range(4) for n in range(9)], count)
    return [
        new_run(setup, one, evaluation=1000 + number, campaign_sequence=c, stage=s, iteration=i, individual=n, score=number % 8)
        for number, (one, (c, s, i, n)) in enumerate(zip(set_ids, origins, strict=True))
    ]


@pytest.mark.parametrize("seed", range(tries(3, 12)))
def test_every_watermark_sees_the_first_run_whenever_keys_were_computed(database: Database, seed: int) -> None:
    chance = random.Random(seed)
    sets = [ParameterSet.of({"P1": decimal(p1) / 10, "P2": decimal(p2)}) for p1 in range(10) for p2 in range(20)]
    chance.shuffle(sets)
    sets = sets[: chance.randint(1, 150)]
    with database.transaction() as connection:
        setup, other = setup_id(connection, "S1"), setup_id(connection, "S2")
        set_ids = parameter_sets.ensure(connection, sets)
        stored = random_runs(chance, len(sets), setup, set_ids)
        ids = []
        for item in stored:  # other setups' runs lie in between
            runs.insert_results(connection, [new_run(other, item.parameter_set_id)])
            ids.append(runs.insert_results(connection, [item])[0].id)
    keys = keys_of_sets(sets)
    newest = ids[-1]
    upto = sorted(chance.sample(range(newest + 1), min(3, newest)))
    chunk = chance.choice([1, 2, 7, 1000])
    new = [reference_keys.sync(database, 1, setup, EVALUATOR, limit, keys_of, chunk=chunk) for limit in [*upto, newest, newest]]
    assert sum(new) == len(sets)
    assert new[-1] == 0

    asked = [*dict.fromkeys(keys), b"nobody has this one"[:16]]
    with database.read() as connection:
        for watermark in (0, *upto, newest, newest + 5):
            expected: dict[bytes, Donor] = {}
            firsts: dict[bytes, NewRun] = {}
            for key, run_id, run in zip(keys, ids, stored, strict=True):
                if run_id <= watermark and (key not in firsts or origin(run) < origin(firsts[key])):
                    firsts[key] = run
                    expected[key] = Donor(run.evaluation_id, run_id, run.score, run.rating, run.failure)
            assert reference_keys.look_up(connection, 1, setup, asked, EVALUATOR, watermark) == expected
        assert reference_keys.look_up(connection, 2, setup, asked, EVALUATOR, newest) == {}
        assert reference_keys.look_up(connection, 1, other, asked, EVALUATOR, newest) == {}
        assert reference_keys.look_up(connection, 1, setup, asked, "learned 1", newest) == {}


@pytest.mark.parametrize("seed", range(tries(3, 6)))
def test_a_run_that_an_evaluator_cannot_rate_hides_no_reference_from_it(database: Database, seed: int) -> None:
    """The first run that an evaluator rated answers for it, whatever other evaluators rated, in any order of computing the keys."""
    chance = random.Random(seed)
    sets = [ParameterSet.of({"P1": decimal("0.4"), "P2": decimal(number)}) for number in range(12)]  # all of one key
    with database.transaction() as connection:
        setup = setup_id(connection)
        stored = random_runs(chance, len(sets), setup, parameter_sets.ensure(connection, sets))
        stored = [replace(item, evaluator=chance.choice([EVALUATOR, "learned 1"])) for item in stored]
        ids = [runs.insert_results(connection, [entry])[0].id for entry in stored]
    evaluators = [EVALUATOR, "learned 1"]
    chance.shuffle(evaluators)
    for evaluator in evaluators:
        rated = sum(element.evaluator == evaluator for element in stored)
        assert reference_keys.sync(database, 1, setup, evaluator, ids[-1], keys_of, chunk=chance.choice([1, 2, 100])) == rated
    [key] = set(keys_of_sets(sets))
    with database.read() as connection:
        for evaluator in evaluators:
            for watermark in ids:
                seen = [
                    (origin(run), one)
                    for one, run in zip(ids, stored, strict=True)
                    if one <= watermark and run.evaluator == evaluator
                ]
                result = reference_keys.look_up(connection, 1, setup, [key], evaluator, watermark)
                assert [donor.run for donor in result.values()] == [one for _, one in sorted(seen)[:1]]


@pytest.mark.parametrize("seed", range(3))
def test_a_rating_that_is_younger_than_its_run_is_seen_from_its_own_number_on(database: Database, seed: int) -> None:
    """Runs that are new, and runs of others that are simulated again for this evaluator, in any order."""
    chance = random.Random(seed)
    sets = [ParameterSet.of({"P1": decimal("0.4"), "P2": decimal(number)}) for number in range(14)]  # all of one key
    with database.transaction() as connection:
        setup = setup_id(connection)
        stored = random_runs(chance, len(sets), setup, parameter_sets.ensure(connection, sets))
        runs.insert_results(connection, stored[:7])
        learned = [replace(element, evaluator="learned 1", from_series=True) for element in stored]
        chance.shuffle(learned)
        numbers: list[tuple[int, NewRun, int]] = []
        for item in learned:
            [run] = runs.insert_results(connection, [replace(item, evaluation_id=1, campaign_sequence=9)])
            numbers.append((runs.largest_id(connection), item, run.id))
        last = runs.largest_id(connection)
    assert len({number for number, _, _ in numbers}) == len(sets)
    chunk = chance.choice([1, 2, 3, 100])
    new = [reference_keys.sync(database, 1, setup, "learned 1", upto, keys_of, chunk=chunk) for upto in (last - 9, last, last)]
    assert sum(new) == len(sets)
    assert new[-1] == 0
    [key] = set(keys_of_sets(sets))
    again = {entry.parameter_set_id for entry in stored[:7]}
    with database.read() as connection:
        for watermark in range(last + 1):
            seen = [
                (origin(one if one.parameter_set_id in again else replace(one, campaign_sequence=9)), run)
                for number, one, run in numbers
                if number <= watermark
            ]
            result = reference_keys.look_up(connection, 1, setup, [key], "learned 1", watermark)
            assert [donor.run for donor in result.values()] == [one for _, one in sorted(seen)[:1]]
            exact = runs.look_up_exact(connection, setup, [each.parameter_set_id for each in stored], "learned 1", watermark)
            assert sorted(donor.run for donor in exact.values()) == sorted(run for _, run in seen)


class CrashError(Exception):
    """Stands for a crash in the middle."""


def test_an_interrupted_sync_goes_on_where_it_was(database: Database) -> None:
    sets = [ParameterSet.of({"P1": decimal("0.4"), "P2": decimal(number)}) for number in range(10)]
    with database.transaction() as connection:
        setup = setup_id(connection)
        stored = [new_run(setup, one, individual=number) for number, one in enumerate(parameter_sets.ensure(connection, sets))]
        last = runs.insert_results(connection, stored)[-1].id
    seen: list[int] = []

    def crash_in_the_third_chunk(names: tuple[str, ...], values: npt.NDArray[np.int64]) -> list[bytes]:
        if len(seen) == 2:
            raise CrashError
        seen.append(len(values))
        return keys_of(names, values)

    with pytest.raises(CrashError):
        reference_keys.sync(database, 1, setup, EVALUATOR, last, crash_in_the_third_chunk, chunk=3)
    assert reference_keys.sync(database, 1, setup, EVALUATOR, last, keys_of, chunk=3) == 4
    with database.read() as connection:
        result = reference_keys.look_up(connection, 1, setup, keys_of_sets(sets[:1]), EVALUATOR, last)
    assert [donor.run for donor in result.values()] == [1]


@pytest.mark.slow
def test_many_keys_are_looked_up_at_once(database: Database) -> None:
    sets = [ParameterSet.of({"P1": decimal("0.3") + decimal(number) / 100_000, "P2": decimal(1)}) for number in range(12_000)]
    with database.transaction() as connection:
        setup = setup_id(connection)
        set_ids = parameter_sets.ensure(connection, sets)
        stored = runs.insert_results(connection, [new_run(setup, one, individual=n) for n, one in enumerate(set_ids)])
    assert reference_keys.sync(database, 1, setup, EVALUATOR, stored[-1].id, keys_of) == 12_000
    with database.read() as connection:
        result = reference_keys.look_up(connection, 1, setup, keys_of_sets(sets), EVALUATOR, stored[-1].id)
    assert [result[key].run for key in keys_of_sets(sets)] == [run.id for run in stored]
