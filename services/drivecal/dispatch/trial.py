"""The trial cell that a worker simulates before it counts as ready."""

from __future__ import annotations

from drivecal.campaigns.resolve.problem import resolve
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import Batch, Cell


def trial() -> Batch:
    """Returns a cell of the built-in plug-ins: the middle of the space in the first scenario.

    It compiles all kernels, which can exceed a batch's time limit. A worker with another version or without a working SUMO refuses it.
    Raises InvalidInputError if the coordinator lacks a plug-in.
    """
    problem = resolve(CampaignSpecification())
    middle = problem.space.parameter_set((problem.space.n_values // 2).tolist())
    return Batch(problem.bench.requests[problem.scenarios[0]], (Cell(0, middle.floats),))
