"""A run that is certified is the run that would have been simulated, for any planner that decides by linear costs."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples, tries

from drivecal.highway.certification.kernels import NONE, contenders
from drivecal.highway.certification.memory import Memory
from drivecal.highway.certification.nodes import Nodes, walk
from drivecal.highway.certification.proofs import NotDeterministicError, Trie
from drivecal.plugins.ports import Floats, Observation, Planner

PLANS = 8
LARGEST = 4.0
"""Of a parameter, either way."""


class Linear:
    """A planner of the certifiable class: features are any function of what was observed, costs are linear in weights that are a function
    of the parameters, and some candidates turn out to be infeasible."""

    period = 1.0
    grid = 1 / 256

    def __init__(self, seed: int, n_candidates: int, n_terms: int, share_infeasible: float) -> None:
        self.n_candidates, self.n_values = n_candidates, n_terms
        self._seed, self._share = seed, share_infeasible
        self._weights = np.zeros(n_terms)
        self._features = np.zeros((n_candidates, n_terms))
        self.infeasible: npt.NDArray[np.bool_] = np.zeros(n_candidates, dtype=np.bool_)
        self.chosen = -1
        self.state = np.zeros(4)
        self.offset = 0.0
        self.planned = 0
        """Number of plans whose candidate was chosen by `plan`."""

    def reset(self, parameters: Sequence[float]) -> None:
        self._weights = np.exp(np.array(parameters))

    def costs(self, features: Floats) -> Floats:
        total = np.zeros(len(features))
        for weight, column in zip(self._weights.tolist(), features.T, strict=True):
            total += weight * column
        return total

    def contenders(self, infeasible: npt.NDArray[np.bool_]) -> tuple[npt.NDArray[np.int64], Floats]:
        lowest, highest = np.full(self.n_values, np.exp(-LARGEST)), np.full(self.n_values, np.exp(LARGEST))
        candidates = contenders(self._features, lowest, highest, infeasible, self.chosen, 4, 1e-6)
        return candidates, self._features[candidates]

    def plan(self, observation: Observation) -> Floats:
        self.state[:3], self.state[3] = observation.ego, self.offset
        self.planned += 1
        return np.array([self._choose(self.state), 0.0])

    def repeat(self, observation: Observation, chosen: int) -> Floats:
        self.state[:3], self.state[3] = observation.ego, self.offset
        self.chosen, self.infeasible = chosen, np.zeros(self.n_candidates, dtype=np.bool_)
        return np.array([chosen, 0.0])

    def decide(self, state: Floats, parameters: Sequence[float]) -> int:
        kept, self._weights = self._weights, np.exp(np.array(parameters))
        chosen = self._choose(state)
        self._weights = kept
        return chosen

    def _choose(self, state: Floats) -> int:
        salt = self._seed.to_bytes(8, "little")
        seen = hashlib.blake2b(state.tobytes(), digest_size=8, salt=salt).digest()
        generator = np.random.default_rng(int.from_bytes(seen, "little"))
        # coarse, so that ties occur; some of them off the grid, some too large for two bytes
        shape = self._features.shape
        self._features = np.round(generator.exponential(2.0, shape))
        odd = generator.random(shape) < 0.05
        self._features[odd] += generator.choice([0.1, 500.0], odd.sum())
        cannot = generator.random(self.n_candidates) < self._share
        costs = self.costs(self._features)
        self.infeasible = np.zeros(self.n_candidates, dtype=np.bool_)
        for candidate in np.argsort(costs, kind="stable").tolist():
            if not cannot[candidate]:
                self.chosen = candidate
                break
            self.infeasible[candidate] = True
        else:
            self.chosen = int(np.argmin(costs))
        return self.chosen

    def walk(self, nodes: Any, parameters: Sequence[float], node: int) -> int:
        self.reset(parameters)
        if max(map(abs, parameters)) > LARGEST:
            return NONE
        return walk(nodes, node, lambda _, features: self.costs(features))


def memory_of(limit: int) -> Memory:
    memory = Memory()
    memory.limit = limit
    return memory


def drive(planner: Planner, parameters: Sequence[float]) -> bytes:
    """A world in which everything depends on what was chosen, and nothing else on the parameters. Some runs end early."""
    planner.reset(parameters)
    ego, history = np.zeros(3), []
    for step in range(PLANS):
        chosen = int(planner.plan(Observation(float(step), ego, np.zeros((0, 6))))[0])
        ego = np.array([step + 1.0, ego[1] * 0.7 + chosen, np.sin(ego[2] + chosen)])
        history.append(ego.tobytes())
        if ego[2] > 0.97:
            break
    return b"".join(history)


def simulate_or_prove(trie: Trie[bytes], parameters: Sequence[float], number: int) -> tuple[bytes, int | None]:
    certificate = trie.prove(parameters)
    if certificate is not None:
        return certificate.result, certificate.proven_by
    recording = trie.record(trie.known)
    result = drive(recording, parameters)
    recording.finish(result, number)
    return result, None


@given(
    seed=st.integers(0, 10_000),
    n_candidates=st.integers(2, 12),
    n_terms=st.integers(1, 5),
    share=st.sampled_from([0.0, 0.3, 0.9, 1.0]),
    room=st.sampled_from([2_000, 20_000, 2**30]),
)
@settings(max_examples=tries(10, 300))
def test_what_is_certified_is_what_would_have_been_simulated(
    seed: int, n_candidates: int, n_terms: int, share: float, room: int
) -> None:
    trie: Trie[bytes] = Trie(Linear(seed, n_candidates, n_terms, share), memory_of(room))
    judge = Linear(seed, n_candidates, n_terms, share)
    generator, simulated, proved = np.random.default_rng(seed), {}, 0
    for number in range(60):
        parameters = np.round(generator.normal(0.0, 1.5, n_terms), 1).tolist()
        result, by = simulate_or_prove(trie, parameters, number)
        truth = drive(judge, parameters)
        assert result == truth
        if by is None:
            simulated[number] = truth
        else:
            proved += 1
            assert simulated[by] == truth  # the run that it names is one that was simulated and went just so
        assert trie.bytes <= room or trie.nodes == 1
    if n_terms == 1 and share == 0.0 and room == 2**30:
        assert proved >= 45  # one weight decides nothing: every set drives alike, but those that nothing is certified for


def test_the_same_set_is_proved_by_its_own_run() -> None:
    trie: Trie[bytes] = Trie(Linear(1, 6, 3, 0.2), Memory())
    assert trie.prove([0.0, 0.5, 1.0]) is None
    result, by = simulate_or_prove(trie, [0.0, 0.5, 1.0], 17)
    assert by is None
    assert simulate_or_prove(trie, [0.0, 0.5, 1.0], 18) == (result, 17)
    assert trie.runs == 1


def test_decisions_shared_with_a_recorded_run_are_known_and_not_planned_again() -> None:
    planner = Linear(1, 6, 3, 0.0)
    trie: Trie[bytes] = Trie(planner, Memory())
    generator, judge = np.random.default_rng(1), Linear(1, 6, 3, 0.0)
    shared = 0
    for number in range(20):
        parameters = generator.normal(0.0, 1.5, 3).tolist()
        if trie.prove(parameters) is not None:
            assert trie.known == []
            continue
        known, before = list(trie.known), planner.planned
        recording = trie.record(known)
        assert drive(recording, parameters) == drive(judge, parameters)
        recording.finish(b"", number)
        decisions = list(recording.recording.decisions)
        assert known == decisions[: len(known)]
        assert planner.planned - before == len(decisions) - len(known)
        shared += len(known)
    assert shared > 0


class Slow(Linear):
    """Computes for a millisecond before it chooses."""

    def plan(self, observation: Observation) -> Floats:
        start = time.thread_time_ns()
        while time.thread_time_ns() - start < 1_000_000:
            pass
        return super().plan(observation)


def test_a_run_is_charged_for_its_recording_less_the_plans_that_it_was_spared() -> None:
    planner = Slow(1, 6, 3, 0.0)
    trie: Trie[bytes] = Trie(planner, Memory())
    first = trie.record()
    drive(first, [0.0, 0.5, 1.0])
    first.finish(b"", 1)
    assert 0 < first.milliseconds < 0.5 * PLANS
    again = trie.record(first.recording.decisions)
    drive(again, [0.0, 0.5, 1.0])
    assert planner.planned == len(first.recording.decisions)
    spared = -again.milliseconds / len(first.recording.decisions)
    assert 0.5 < spared < trie.spent[False].mean / 1e6


def test_a_world_that_is_not_deterministic_is_noticed_although_decisions_are_known() -> None:
    planner = Linear(5, 4, 2, 0.0)
    trie: Trie[bytes] = Trie(planner, Memory())
    simulate_or_prove(trie, [0.0, 0.0], 0)
    assert trie.prove([0.0, 3.0]) is None
    assert trie.known
    planner.offset = 0.25
    recording = trie.record(trie.known)
    result = drive(recording, [0.0, 3.0])
    with pytest.raises(NotDeterministicError):
        recording.finish(result, 1)


def test_a_winner_that_was_never_tested_for_feasibility_proves_nothing() -> None:
    """Two candidates; the first run prefers candidate 0. A set that prefers candidate 1 cannot know whether it can be driven."""
    trie: Trie[bytes] = Trie(Linear(3, 2, 2, 0.0), Memory())
    results = {}
    for number, parameters in enumerate(([0.0, 3.0], [3.0, 0.0], [0.0, 3.0], [3.0, 0.0])):
        results[number] = simulate_or_prove(trie, parameters, number)
    assert results[0][0] != results[1][0]
    assert [by for _, by in results.values()] == [None, None, 0, 1]


def test_a_full_memory_forgets_what_was_visited_for_longest_ago_whichever_trie_it_is_in() -> None:
    memory = memory_of(60_000)
    favoured, other = (Trie[bytes](Linear(seed, 10, 4, 0.1), memory) for seed in (5, 6))
    generator = np.random.default_rng(1)
    favourite = [0.1, 0.2, 0.3, 0.4]
    simulate_or_prove(favoured, favourite, 0)
    for number in range(1, 100):
        for trie in (favoured, other):
            simulate_or_prove(trie, generator.normal(0, 2, 4).tolist(), number)
            assert memory.bytes <= memory.limit
        certificate = favoured.prove(favourite)
        assert certificate is not None
        assert certificate.proven_by == 0
    assert favoured.runs + other.runs < 30
    assert memory.states == favoured.nodes + other.nodes


def test_a_memory_that_the_first_states_of_many_tries_fill_forgets_all_others() -> None:
    memory = memory_of(1)
    tries: list[Trie[bytes]] = [Trie(Linear(seed, 6, 3, 0.0), memory) for seed in range(2 * PLANS)]
    for trie in tries:
        simulate_or_prove(trie, (0.0, 0.0, 0.0), 1)
    assert memory.states == len(tries)
    assert all(trie.runs == 0 for trie in tries)


def test_the_memory_of_a_trie_that_is_gone_is_free() -> None:
    memory = Memory()
    trie: Trie[bytes] = Trie(Linear(1, 6, 3, 0.2), memory)
    simulate_or_prove(trie, [0.0, 0.5, 1.0], 1)
    assert memory.bytes > 0
    del trie
    assert memory.bytes == memory.states == 0


def test_a_world_that_is_not_deterministic_is_noticed() -> None:
    planner = Linear(5, 4, 2, 0.0)
    trie: Trie[bytes] = Trie(planner, Memory())
    simulate_or_prove(trie, [0.0, 0.0], 0)
    planner.offset = 0.25
    recording = trie.record()
    result = drive(recording, [0.0, 0.0])
    with pytest.raises(NotDeterministicError, match="0 s"):
        recording.finish(result, 1)


def test_a_run_that_was_interrupted_proves_nothing_and_spoils_nothing() -> None:
    planner = Linear(8, 5, 3, 0.1)
    trie: Trie[bytes] = Trie(planner, Memory())
    recording = trie.record()
    recording.reset([0.0, 0.1, 0.2])
    recording.plan(Observation(0.0, np.zeros(3), np.zeros((0, 6))))
    assert trie.prove([0.0, 0.1, 0.2]) is None
    result, by = simulate_or_prove(trie, [0.0, 0.1, 0.2], 1)
    assert by is None
    assert simulate_or_prove(trie, [0.0, 0.1, 0.2], 2) == (result, 1)


def test_parameters_beyond_what_was_allowed_for_are_never_certified() -> None:
    trie: Trie[bytes] = Trie(Linear(1, 6, 2, 0.2), Memory())
    for number in (1, 2):
        assert simulate_or_prove(trie, [0.0, LARGEST + 0.1], number)[1] is None
    inside = simulate_or_prove(trie, [0.0, LARGEST], 3)
    assert simulate_or_prove(trie, [0.0, LARGEST], 4) == (inside[0], inside[1] or 3)


@given(
    seed=st.integers(0, 10_000),
    n_candidates=st.integers(2, 30),
    n_terms=st.integers(1, 5),
    leaders=st.integers(1, 16),
    share=st.sampled_from([0.0, 0.5]),
)
@settings(max_examples=examples(40))
def test_every_candidate_that_can_win_is_a_contender(
    seed: int, n_candidates: int, n_terms: int, leaders: int, share: float
) -> None:
    generator = np.random.default_rng(seed)
    features = np.round(generator.exponential(2.0, (n_candidates, n_terms)), 1)
    lowest = generator.uniform(0, 1, n_terms)
    highest = lowest + generator.uniform(0, 3, n_terms)
    infeasible = generator.random(n_candidates) < share
    chosen = int(generator.integers(n_candidates))
    candidates = contenders(features, lowest, highest, infeasible, chosen, leaders, 1e-9).tolist()
    assert candidates == sorted(set(candidates))
    assert chosen in candidates
    for _ in range(200):
        weights = generator.uniform(lowest, highest)
        corner = generator.random(n_terms)
        weights = np.where(corner < 0.3, lowest, np.where(corner > 0.7, highest, weights))
        costs = features @ weights
        feasible = np.flatnonzero(~infeasible)
        best = feasible if feasible.size else np.arange(n_candidates)
        assert int(best[np.argmin(costs[best])]) in candidates


def test_what_is_stored_of_a_state_are_its_contenders_alone() -> None:
    features = np.array([[1.0, 1.0], [1.0, 9.0], [9.0, 1.0], [0.5, 2.0]])
    everywhere, nowhere = np.array([0.1, 0.1]), np.array([10.0, 10.0])
    none = np.zeros(4, dtype=np.bool_)
    assert contenders(features, everywhere, nowhere, none, 0, 4, 1e-9).tolist() == [0, 3]
    beaten = np.array([True, False, False, True])
    assert contenders(features, everywhere, nowhere, beaten, 0, 4, 1e-9).tolist() == [0, 1, 2, 3]
    assert Nodes(2, 4, 1 / 256).rows == 0
