"""A run certifies the same cells at a worker that it was sent to as at the worker that simulated it."""

from __future__ import annotations

import pickle

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivecal.domain.evaluations import Rating, RunResult
from drivecal.highway.certification.recording import DecisionRecord, packed, unpacked

RESULT = RunResult(Rating(5.25, 5), {"value": 1.0})


@given(
    plans=st.integers(1, 5),
    size=st.integers(1, 4),
    n_candidates=st.integers(1, 20),
    seed=st.integers(0, 1000),
)
def test_a_recording_comes_back_bit_for_bit(plans: int, size: int, n_candidates: int, seed: int) -> None:
    generator = np.random.default_rng(seed)
    states = [generator.choice([0.0, -0.0, np.nan, 1e-300, 0.1], size=size) for _ in range(plans)]
    masks = [(plan, generator.random(n_candidates) < 0.5) for plan in range(0, plans, 2)]
    recording = DecisionRecord([0.1, -2.0], states, generator.integers(0, n_candidates, plans).tolist(), masks)
    sent = pickle.loads(pickle.dumps(packed(recording, RESULT, 7)))
    again = unpacked(sent, n_candidates)
    assert (sent.number, sent.result) == (7, RESULT)
    assert (list(again.parameters), list(again.decisions)) == (recording.parameters, recording.decisions)
    assert np.array(again.states).tobytes() == np.array(states).tobytes()
    assert [plan for plan, _ in again.infeasible] == [plan for plan, _ in masks]
    assert all(np.array_equal(new, old) for (_, new), (_, old) in zip(again.infeasible, masks, strict=True))
