"""A runner that answers by a certificate if it can, and simulates otherwise."""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from time import thread_time_ns
from typing import Any

from drivecal.contracts.work import RecordedRun
from drivecal.domain.evaluations import RunResult
from drivecal.domain.scenarios import Scenario
from drivecal.highway.certification.memory import Memory
from drivecal.highway.certification.proofs import NotDeterministicError, Trie
from drivecal.highway.certification.recording import packed, unpacked
from drivecal.highway.episode.runner import EpisodeRunner
from drivecal.plugins.ports import DrivingFunction, Evaluator, VehicleModel


class CertifiedRunner(EpisodeRunner):
    """A runner that records decisions if its driving function can be certified.

    `parameters`: names of the driving function's parameters in the order of `run`.
    """

    def __init__(
        self,
        scenario: Scenario,
        driving_function: DrivingFunction,
        vehicle: VehicleModel,
        evaluator: Evaluator,
        memory: Memory,
    ) -> None:
        """Creates a runner like `EpisodeRunner`. `memory`: limits the recorded decisions."""
        super().__init__(scenario, driving_function, vehicle, evaluator)
        self.parameters = tuple(parameter.name for parameter in next(iter(driving_function.spaces.values())))
        self._certifiable = driving_function.certifiable
        self._memory = memory
        self.trie: Trie[RunResult] | None = None
        self.unsent: list[RecordedRun] | None = None
        """Runs for other workers; None if no other worker wants them."""
        self.contradicted = False
        """A run of another worker contradicted a recorded run: it learns from no worker any more."""

    def answer(self, parameters: Sequence[float], number: int, *, check: bool) -> RunResult:
        """Returns the result for these parameter values, by a certificate if possible.

        A simulated run is recorded under `number` and may certify later ones. It does not make the decisions again that it provably shares
        with recorded runs. `check`: simulate in any case, and plan everything. Raises like `run`.
        """
        if not self._certifiable:
            return self.run(parameters)
        start = thread_time_ns()
        trie = self._trie_to_fill()
        certificate = trie.prove(parameters)
        if certificate is not None and not check:
            return replace(certificate.result, proven_by=certificate.proven_by, certifying=_milliseconds(start))
        known = [] if check else trie.known
        recording = trie.record(known)
        before = _milliseconds(start)
        result = self.run(parameters, recording)
        start = thread_time_ns()
        deterministic = True
        try:
            recording.finish(result, number)
        except NotDeterministicError:
            self.forget()
            deterministic = False
            if known:  # nothing was proven, so that the run may have driven decisions of another state
                result = self.run(parameters)
        certifying = before + recording.milliseconds + _milliseconds(start)
        if not deterministic:
            return replace(result, agrees=False, certifying=certifying)
        if certificate is None:
            if self.unsent is not None:
                self.unsent.append(packed(recording.recording, result, number))
            return replace(result, certifying=certifying)
        agrees = result == certificate.result
        if not agrees:
            self.forget()
        return replace(result, proven_by=certificate.proven_by, agrees=agrees, certifying=certifying)

    def prove(self, parameters: Sequence[float]) -> int | None:
        """Returns the number of the run that these parameters would provably repeat, or None. Simulates nothing."""
        certificate = None if self.trie is None else self.trie.prove(parameters)
        return None if certificate is None else certificate.proven_by

    def learn(self, known: Sequence[RecordedRun]) -> None:
        """Records runs of other workers, and from now on keeps its own for `recorded`.

        A run that contradicts a recorded run refutes all proofs: the worker forgets its runs and stops learning from other workers.
        """
        if not self._certifiable or self.contradicted:
            return
        self.unsent = []
        trie, n_candidates = self._trie_to_fill(), self._certifiable_planner.n_candidates
        try:
            for run in known:
                trie.learn(unpacked(run, n_candidates), run.result, run.number)
        except NotDeterministicError:
            self.contradicted, self.unsent = True, None
            self.forget()

    def recorded(self, most_bytes: int) -> tuple[RecordedRun, ...]:
        """Returns runs recorded since `learn`, for other workers, best rating first: an optimizer asks for sets like the best."""
        unsent, self.unsent = self.unsent or [], None
        ranked = sorted(unsent, key=lambda run: -run.result.rating.rating)
        total = itertools.accumulate(len(run.states) for run in ranked)
        return tuple(run for run, size in zip(ranked, total, strict=True) if size <= most_bytes)

    def take_over(self, interrupted: "CertifiedRunner") -> None:
        """Takes the recorded runs of a runner of the same setup, unless an exception interrupted the trie itself.

        A run is recorded at its end, so that an exception of planner, vehicle, simulator or evaluator leaves the trie as it was.
        """
        self.unsent, self.contradicted = interrupted.unsent, interrupted.contradicted
        trie, interrupted.trie = interrupted.trie, None
        if trie is not None and trie.is_intact:
            trie.use(self._certifiable_planner)
            self.trie = trie

    def _trie_to_fill(self) -> Trie[RunResult]:
        if self.trie is None:
            self.trie = Trie(self._certifiable_planner, self._memory)
        return self.trie

    @property
    def _certifiable_planner(self) -> Any:
        """The planner: a `certifiable` driving function creates `CertifiablePlanner`s."""
        return self.planner

    def forget(self) -> None:
        """Forgets all recorded runs and frees their memory."""
        self.trie = None


def _milliseconds(start: int) -> float:
    """Returns the CPU time of this thread since `start` (of `time.thread_time_ns`)."""
    return (thread_time_ns() - start) / 1e6
