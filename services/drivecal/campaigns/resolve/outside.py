"""Grid indices of the sets that an outside optimizer proposes to a campaign."""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.resolve.spaces import coefficients_in
from drivecal.contracts.outside.sets import ProposedSet
from drivecal.domain.errors import Diagnostics
from drivecal.domain.parameters import Indices, ParameterSpace
from drivecal.domain.values import Setting, Value, decimal
from drivecal.optimizers.built_in import ExternalSettings


def indices_of(problem: CalibrationProblem, proposed: Sequence[ProposedSet], diagnostics: Diagnostics) -> Indices:
    """Returns the nearest grid points of proposed sets, shape (n, n_searched); adds notes.

    With `infeasible: repair` values outside of the bounds become the bounds, and sets that break constraints near feasible ones.
    Raises InvalidInputError naming each faulty field.
    """
    settings = None if problem.optimization is None else problem.optimization.settings
    repairs = isinstance(settings, ExternalSettings) and settings.infeasible == "repair"
    space, constraints = problem.space, problem.search_constraints
    rows = np.zeros((len(proposed), len(space.searched)), dtype=np.int64)
    for number, each in enumerate(proposed):
        field = f"sets[{number}].parameters"
        values = coefficients_in(space, each.parameters, problem.bench.bundle.manifest.shapes, field, diagnostics)
        if values is None:
            continue
        points = [parameter.nearest(values.get(parameter.name), clips=repairs) for parameter in space.searched]
        known = [index for index in points if index is not None]
        if len(known) == len(points):
            rows[number] = known
        if len(known) < max(len(points), len(values)):  # a faulty value, or a fixed one
            diagnostics.attempt(partial(space.indices, _rounded(space, values, points), field))
        if each.replicates > 1 and not problem.bench.is_random:
            remedy = "leave it out, or say `random: true` in the problem's manifest"
            diagnostics.add(f"sets[{number}].replicates", "the simulator is not random", remedy)
        for name in each.scenarios or ():
            if name not in problem.scenarios:
                message, remedy = f"the campaign does not simulate {name!r}", f"one of {', '.join(problem.scenarios)}"
                diagnostics.add(f"sets[{number}].scenarios", message, remedy)
    diagnostics.raise_if_any()
    if not constraints:
        return rows
    if repairs:
        last = space.n_values - 1
        return constraints.region(0 * last, last).repair(rows)
    for number in np.flatnonzero(~constraints.feasible(rows)).tolist():
        made = space.parameter_set(rows[number].tolist())
        diagnostics.attempt(partial(constraints.check, made, f"sets[{number}].parameters"))
    diagnostics.raise_if_any()
    return rows


def _rounded(space: ParameterSpace, proposed: Mapping[str, Setting], nearest: Sequence[int | None]) -> dict[str, Value]:
    """Returns the values of a set, rounded to their nearest grid points as far as they have some."""
    values: dict[str, Value] = {name: value if isinstance(value, str) else decimal(value) for name, value in proposed.items()}
    points = zip(space.searched, nearest, strict=True)
    return values | {parameter.name: parameter.named(index) for parameter, index in points if index is not None}
