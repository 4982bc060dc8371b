"""Certificates of the built-in planner in real SUMO runs: what is proved is what a simulation gives, bit for bit."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from drivecal.domain.evaluations import RunResult
from drivecal.highway.certification.memory import Memory
from drivecal.highway.comfort.reference import REFERENCE
from drivecal.highway.episode.certified import CertifiedRunner
from drivecal.highway.episode.runner import EpisodeRunner
from drivecal.highway.planner.frenet import FRENET
from drivecal.highway.planner.planner import FrenetPlanner
from drivecal.highway.planner.spaces import HIGHWAY as SPACE
from drivecal.highway.scenarios.highway import HIGHWAY
from drivecal.highway.vehicle.single_track import SINGLE_TRACK
from drivecal.plugins.ports import Floats, Observation

NOMINAL = {one.name: one.nominal for one in SINGLE_TRACK.parameters}
GRIDS = [[float(parameter.value(index)) for index in range(parameter.n_values)] for parameter in SPACE]


def sets(seed: int, families: int, members: int) -> list[list[float]]:
    """Families as a genetic algorithm breeds them: members share most values with the first."""
    generator = np.random.default_rng(seed)
    found = []
    for _ in range(families):
        parent = [float(generator.choice(grid)) for grid in GRIDS]
        for _ in range(members):
            child = list(parent)
            for place in generator.choice(len(GRIDS), size=2, replace=False).tolist():
                child[place] = float(generator.choice(GRIDS[place]))
            found.append(child)
    return found


def runner(name: str, memory: Memory | None = None) -> CertifiedRunner:
    return CertifiedRunner(HIGHWAY.scenarios[name], FRENET, SINGLE_TRACK.create(NOMINAL), REFERENCE, memory or Memory())


@pytest.mark.slow("S2", "S4", "S6", "S3", "S5")
@pytest.mark.parametrize("name", list(HIGHWAY.scenarios))
def test_what_is_certified_is_what_a_simulation_gives_bit_for_bit(name: str) -> None:
    certifying = runner(name)
    judge = EpisodeRunner(HIGHWAY.scenarios[name], FRENET, SINGLE_TRACK.create(NOMINAL), REFERENCE)
    simulated: dict[int, RunResult] = {}
    proved = 0
    for number, parameters in enumerate(sets(seed=4, families=3, members=20)):
        answered = certifying.answer(parameters, number, check=False)
        truth = judge.run(parameters)
        assert replace(answered, proven_by=None) == truth
        if answered.proven_by is None:
            simulated[number] = truth
        else:
            proved += 1
            assert simulated[answered.proven_by] == truth
    assert proved >= 3


def test_a_check_simulates_and_compares() -> None:
    certifying = runner("S5")
    parameters = sets(seed=1, families=1, members=1)[0]
    assert certifying.answer(parameters, 1, check=True).proven_by is None
    checked = certifying.answer(parameters, 2, check=True)
    assert (checked.proven_by, checked.agrees) == (1, True)


def test_a_simulation_plans_nothing_that_is_proven(monkeypatch: pytest.MonkeyPatch) -> None:
    certifying, plain = runner("S3"), runner("S3")
    planner = certifying.planner
    assert isinstance(planner, FrenetPlanner)
    plan, repeat = Mock(wraps=planner.plan), Mock(wraps=planner.repeat)
    monkeypatch.setattr(planner, "plan", plan)
    monkeypatch.setattr(planner, "repeat", repeat)
    *family, last = sets(seed=5, families=1, members=9)
    for number, parameters in enumerate(family):
        answered = certifying.answer(parameters, number, check=False)
        assert replace(answered, proven_by=None) == plain.run(parameters)
    assert repeat.call_count > 0.1 * plan.call_count
    repeat.reset_mock()
    certifying.answer(last, 9, check=True)
    repeat.assert_not_called()


def test_a_run_whose_proven_decisions_met_another_state_is_simulated_again(monkeypatch: pytest.MonkeyPatch) -> None:
    certifying, plain = runner("S5"), runner("S5")
    first, second = sets(seed=4, families=1, members=2)
    certifying.answer(first, 1, check=False)
    planner = certifying.planner
    assert isinstance(planner, FrenetPlanner)
    repeat = planner.repeat

    def disturbed(observation: Observation, chosen: int) -> Floats:
        """Repeats a plan as if the simulation had gone another way."""
        return repeat(replace(observation, ego=observation.ego + 1e-3), chosen)

    monkeypatch.setattr(planner, "repeat", disturbed)
    answered = certifying.answer(second, 2, check=False)
    assert answered.agrees is False
    assert replace(answered, agrees=None) == plain.run(second)
    assert certifying.trie is None


def test_certificates_report_what_they_took_apart_from_the_run() -> None:
    certifying = runner("S5")
    parameters = sets(seed=1, families=1, members=1)[0]
    answers = [certifying.answer(parameters, number, check=number == 3) for number in range(1, 4)]
    assert [answer.proven_by for answer in answers] == [None, 1, 1]
    assert all(answer.certifying > 0 for answer in answers)
    assert certifying.run(parameters).certifying == 0


def test_what_is_forgotten_is_simulated_again() -> None:
    certifying = runner("S5")
    parameters = sets(seed=1, families=1, members=1)[0]
    certifying.answer(parameters, 1, check=False)
    certifying.forget()
    assert certifying.answer(parameters, 2, check=False).proven_by is None


@pytest.mark.slow
def test_a_small_memory_forgets_in_all_scenarios_and_stays_right() -> None:
    memory = Memory(megabytes=1)
    names = ("S3", "S5")
    certifying = {name: runner(name, memory) for name in names}
    judges = {name: EpisodeRunner(HIGHWAY.scenarios[name], FRENET, SINGLE_TRACK.create(NOMINAL), REFERENCE) for name in names}
    before, forgot = 0, 0
    for number, parameters in enumerate(sets(seed=9, families=3, members=6)):
        for name in names:
            answered = certifying[name].answer(parameters, number, check=False)
            assert replace(answered, proven_by=None) == judges[name].run(parameters)
            assert memory.bytes <= memory.limit
            forgot += memory.bytes < before
            before = memory.bytes
    assert forgot


def test_a_run_of_another_worker_certifies_what_it_certifies_there() -> None:
    families = sets(seed=4, families=3, members=12)
    sender, reader, judge = runner("S5"), runner("S5"), runner("S5")
    proved = 0
    for number, parameters in enumerate(families):
        truth = judge.run(parameters)
        sender.learn(())
        sender.answer(parameters, number, check=False)
        reader.learn(sender.recorded(2**20))
        answered = reader.answer(parameters, 1000 + number, check=False)
        assert answered.proven_by is not None
        assert answered.proven_by < 1000
        assert replace(answered, proven_by=None) == truth
        proved += sender.prove(parameters) != number
    assert proved >= 5
    assert reader.recorded(2**20) == ()


def test_a_run_that_contradicts_the_own_runs_ends_the_learning() -> None:
    sender, reader = runner("S5"), runner("S5")
    first, second, third = sets(seed=2, families=3, members=1)
    sender.learn(())
    for number, parameters in enumerate((first, second), 1):
        sender.answer(parameters, number, check=False)
    one, other = sender.recorded(2**20)
    reader.answer(first, 10, check=False)
    shifted = np.frombuffer(one.states).copy()
    shifted[3] += 1e-9
    reader.learn([other, replace(one, states=shifted.tobytes())])
    assert reader.prove(first) is None
    assert reader.prove(second) is None
    reader.learn([other])
    assert reader.prove(second) is None
    assert reader.answer(third, 11, check=False).proven_by is None
    assert reader.answer(third, 12, check=False).proven_by == 11
    assert reader.recorded(2**20) == ()
