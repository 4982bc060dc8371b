"""Runs that are answered by a certificate where there is one, and simulated where there is none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from drivecal.certification.memory import Memory
from drivecal.certification.trie import NotDeterministicError, Trie
from drivecal.domain.evaluations import Answered, RunResult
from drivecal.domain.scenarios import Scenario
from drivecal.episode.runner import EpisodeRunner
from drivecal.plugins.ports import DrivingFunction, Evaluator, VehicleModel


class CertifiedRunner(EpisodeRunner):
    """A runner that remembers decisions where its driving function can be certified."""

    def __init__(
        self,
        scenario: Scenario,
        driving_function: DrivingFunction,
        vehicle: VehicleModel,
        evaluator: Evaluator,
        memory: Memory,
    ) -> None:
        """See `EpisodeRunner`; `memory`: for what is remembered."""
        super().__init__(scenario, driving_function, vehicle, evaluator)
        self._certifiable = driving_function.certifiable
        self._memory = memory
        self._trie: Trie[RunResult] | None = None

    def answer(self, parameters: Sequence[float], number: int, *, check: bool) -> Answered:
        """The result for these parameter values, by a certificate where there is one. A run that is simulated may certify others, as
        number `number`. `check`: simulated in any case. Raises as `run`."""
        if not self._certifiable:
            return Answered(self.run(parameters))
        if self._trie is None:
            planner: Any = self.planner  # a driving function that is `certifiable` makes `CertifiablePlanner`s
            self._trie = Trie(planner, self._memory)
        proof = self._trie.prove(parameters)
        if proof is not None and not check:
            return Answered(proof.result, proof.proven_by)
        recording = self._trie.record()
        result = self.run(parameters, recording)
        try:
            recording.finish(result, number)
        except NotDeterministicError:
            self.forget()
            return Answered(result, agrees=False)
        return Answered(result) if proof is None else Answered(result, proof.proven_by, result == proof.result)

    def prove(self, parameters: Sequence[float]) -> int | None:
        """The number of the run that these parameters would provably repeat; None where that is not known. Simulates nothing."""
        proof = None if self._trie is None else self._trie.prove(parameters)
        return None if proof is None else proof.proven_by

    def forget(self) -> None:
        """Gives the memory back; what comes is simulated again."""
        self._trie = None
