"""A runner that answers by a certificate if it can, and simulates otherwise."""

from collections.abc import Sequence
from dataclasses import replace
from time import thread_time_ns
from typing import Any

from drivecal.certification.memory import Memory
from drivecal.certification.trie import NotDeterministicError, Trie
from drivecal.domain.evaluations import RunResult
from drivecal.domain.scenarios import Scenario
from drivecal.episode.runner import EpisodeRunner
from drivecal.plugins.ports import DrivingFunction, Evaluator, VehicleModel


class CertifiedRunner(EpisodeRunner):
    """A runner that records decisions if its driving function can be certified."""

    def __init__(
        self,
        scenario: Scenario,
        driving_function: DrivingFunction,
        vehicle: VehicleModel,
        evaluator: Evaluator,
        memory: Memory,
    ) -> None:
        """Like `EpisodeRunner`. `memory`: limits the recorded decisions."""
        super().__init__(scenario, driving_function, vehicle, evaluator)
        self._certifiable = driving_function.certifiable
        self._memory = memory
        self._trie: Trie[RunResult] | None = None

    def answer(self, parameters: Sequence[float], number: int, *, check: bool) -> RunResult:
        """Returns the result for these parameter values, by a certificate if possible.

        A simulated run is recorded under `number` and may certify later ones. `check`: simulate in any case. Raises like `run`.
        """
        if not self._certifiable:
            return self.run(parameters)
        start = thread_time_ns()
        if self._trie is None:
            planner: Any = self.planner  # a `certifiable` driving function creates `CertifiablePlanner`s
            self._trie = Trie(planner, self._memory)
        certificate = self._trie.prove(parameters)
        if certificate is not None and not check:
            return replace(certificate.result, proven_by=certificate.proven_by, certifying=_milliseconds(start))
        recording = self._trie.record()
        before = _milliseconds(start)
        result = self.run(parameters, recording)
        start = thread_time_ns()
        deterministic = True
        try:
            recording.finish(result, number)
        except NotDeterministicError:
            self.forget()
            deterministic = False
        certifying = before + recording.milliseconds + _milliseconds(start)
        if not deterministic:
            return replace(result, agrees=False, certifying=certifying)
        if certificate is None:
            return replace(result, certifying=certifying)
        agrees = result == certificate.result
        return replace(result, proven_by=certificate.proven_by, agrees=agrees, certifying=certifying)

    def prove(self, parameters: Sequence[float]) -> int | None:
        """Returns the number of the run that these parameters would provably repeat, or None. Simulates nothing."""
        certificate = None if self._trie is None else self._trie.prove(parameters)
        return None if certificate is None else certificate.proven_by

    def forget(self) -> None:
        """Forgets all recorded runs and frees their memory."""
        self._trie = None


def _milliseconds(start: int) -> float:
    """Returns the CPU time of this thread since `start` (of `time.thread_time_ns`)."""
    return (thread_time_ns() - start) / 1e6
