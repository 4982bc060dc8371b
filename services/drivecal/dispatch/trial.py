"""What a worker has to simulate before it counts as ready."""

from __future__ import annotations

from drivecal.campaigns.resolve.problem import resolve
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import Batch, Cell


def trial() -> Batch:
    """One cell of drivecal's own plug-ins: the middle of the space in the first scenario.

    It compiles all kernels, which can take longer than any batch may, and a worker with another version or without a working SUMO
    refuses it. Raises InvalidInputError where the coordinator itself lacks a plug-in.
    """
    problem = resolve(CampaignSpecification())
    middle = problem.space.parameter_set((problem.space.n_values // 2).tolist())
    return Batch(problem.bench.requests[problem.scenarios[0]], (Cell(0, middle.floats),))
