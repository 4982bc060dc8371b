"""Records of simulated runs for certificates, and their form on the way to other workers."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from drivecal.contracts.work import RecordedRun
from drivecal.domain.evaluations import RunResult
from drivecal.highway.certification.nodes import Floats


@dataclass(slots=True)
class DecisionRecord:
    """Planning states and decisions of a run, in order."""

    parameters: Sequence[float] = ()
    states: Sequence[Floats] | Floats = field(default_factory=list)
    """Shape (n_state,) each."""
    decisions: Sequence[int] = field(default_factory=list)
    infeasible: Sequence[tuple[int, npt.NDArray[np.bool_]]] = field(default_factory=list)
    """Number of each plan with infeasible candidates, and their mask, shape (n_candidates,)."""


def packed(recording: DecisionRecord, result: RunResult, number: int) -> RecordedRun:
    """Returns the run of cell `number` for other workers."""
    return RecordedRun(
        number,
        result,
        tuple(recording.parameters),
        tuple(recording.decisions),
        np.array(recording.states).tobytes(),
        tuple((plan, np.packbits(mask).tobytes()) for plan, mask in recording.infeasible),
    )


def unpacked(run: RecordedRun, n_candidates: int) -> DecisionRecord:
    """Inverts `packed`. Raises ValueError if the run is not of this form."""
    states = np.frombuffer(run.states).reshape(len(run.decisions), -1).copy()  # kernels are compiled for writable arrays
    masks = ((plan, np.frombuffer(mask, dtype=np.uint8)) for plan, mask in run.infeasible)
    infeasible = [(plan, np.unpackbits(mask, count=n_candidates).astype(np.bool_)) for plan, mask in masks]
    return DecisionRecord(run.parameters, states, run.decisions, infeasible)
