"""Resolves a comparison into its campaigns, and reports its problems."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

from sqlalchemy import Connection

from drivecal.analysis.comparison import Conditions
from drivecal.campaigns.resolve.bundle_bench import BundleSource
from drivecal.campaigns.resolve.diagnostics import Diagnostics
from drivecal.campaigns.resolve.problem import CalibrationProblem, resolve
from drivecal.campaigns.resolve.workbench import no_bundles
from drivecal.contracts.comparison import LARGEST_RUNS, ComparedOptimizer, ComparisonSpecification
from drivecal.contracts.input_errors import validated
from drivecal.contracts.specification import HIGHWAY, CampaignSpecification, ReductionSpecification
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.storage import campaigns
from drivecal.storage.campaigns import StoredCampaign

COMMON = {"population": "populations", "iterations": "iterations", "start": "start", "seed": "seeds"}
"""Settings that the comparison chooses for every optimizer, and their fields."""

CONFIRMED = 100
"""Sets of a run with references or predictions that are simulated after its search at most, unless `confirm` is given: a dozen is many. A
run for which they were too few notes it."""


@dataclass(frozen=True, slots=True)
class Run:
    """A run: its conditions and its campaign."""

    conditions: Conditions
    specification: CampaignSpecification


@dataclass(frozen=True, slots=True)
class ComparisonProblem:
    """A comparison that can run."""

    specification: ComparisonSpecification
    runs: tuple[Run, ...]
    problems: tuple[CalibrationProblem, ...]
    """Problems of the first seed's runs; they represent the other seeds."""

    @property
    def proposed(self) -> int:
        """The cells that all runs together propose."""
        return len(self.specification.seeds) * sum(
            problem.expected_runs().calibration_proposed + problem.expected_runs().sensitivity_at_most
            for problem in self.problems
        )

    @property
    def at_most(self) -> int:
        """The simulations of all runs together if they share no cell."""
        return len(self.specification.seeds) * sum(
            problem.expected_runs().calibration_at_most + problem.expected_runs().sensitivity_at_most
            for problem in self.problems
        )


def runs_of(specification: ComparisonSpecification) -> list[Run]:
    """The runs in order: by optimizer, population, seed, reduction. Depends on the specification alone."""
    labels = [optimizer.label or optimizer.kind for optimizer in specification.optimizers]
    reductions = [_settled(reduction) for reduction in specification.reductions]
    several = len(reductions) > 1
    runs = []
    for (label, optimizer), population, seed, reduction in product(
        zip(labels, specification.optimizers, strict=True), specification.populations, specification.seeds, reductions
    ):
        conditions = Conditions(label, population, seed, reduction_label(reduction))
        name = f"{label}, population {population}, seed {seed}{f', {conditions.reduction}' if several else ''}"
        runs.append(Run(conditions, _campaign(specification, name, optimizer, conditions, reduction)))
    return runs


def resolve_comparison(specification: ComparisonSpecification, bundles: BundleSource = no_bundles) -> ComparisonProblem:
    """Resolves a comparison's specification. Raises InvalidInputError with every problem at its field."""
    diagnostics = Diagnostics()
    _check_lists(specification, diagnostics)
    diagnostics.raise_if_any()
    runs = runs_of(specification)
    resolved = []
    at = product(range(len(specification.optimizers)), specification.populations, specification.seeds)
    places = product(at, range(len(specification.reductions)))
    for run, ((optimizer, _, seed), reduction) in zip(runs, places, strict=True):
        if seed == specification.seeds[0]:
            try:
                resolved.append(resolve(run.specification, bundles))
            except InvalidInputError as error:
                diagnostics.problems.extend(_here(problem, optimizer, reduction) for problem in error.problems)
    diagnostics.problems = list(dict.fromkeys(diagnostics.problems))
    diagnostics.raise_if_any()
    settled = [each if isinstance(each, str) else _settled(each) for each in specification.reductions]
    specification = specification.model_copy(update={"problem": resolved[0].specification.problem, "reductions": settled})
    return ComparisonProblem(specification, tuple(runs_of(specification)), tuple(resolved))


def queue(
    connection: Connection,
    problem: ComparisonProblem,
    influence_map_id: str | None = None,
    idempotency_key: str | None = None,
    body_digests: Sequence[str] = (),
) -> StoredCampaign:
    """Queues a comparison with its runs; returns the earlier comparison if the request key is known, as `campaigns.insert` does.

    `influence_map_id` identifies the map that the comparison names.
    """
    specification = problem.specification
    stored = campaigns.insert(
        connection,
        name=specification.name,
        spec=specification.model_dump(mode="json"),
        kind="comparison",
        idempotency_key=idempotency_key,
        body_digests=body_digests,
        priority=specification.priority,
    )
    if not campaigns.runs_of(connection, stored.sequence):
        for run in problem.runs:
            made = campaigns.insert(
                connection,
                name=run.specification.name,
                spec=run.specification.model_dump(mode="json"),
                influence_map_id=None if run.specification.sensitivity is None else influence_map_id,
                parent_sequence=stored.sequence,
                priority=specification.priority,
            )
            if specification.problem != HIGHWAY:  # it cannot change until the run starts, as plug-ins can
                campaigns.set_resolution(connection, made.sequence, problem.problems[0].resolution())
    return stored


def reduction_label(reduction: ReductionSpecification) -> str:
    """The mode, with the settings that differ from the defaults of comparisons. `reduction` is settled."""
    others = reduction.model_dump(exclude_defaults=True, exclude={"mode", "confirm"})
    if _confirms(reduction) and reduction.confirm != CONFIRMED:
        others["confirm"] = reduction.confirm
    return " ".join([reduction.mode, *(f"{name}={value}" for name, value in others.items())])


def _confirms(reduction: ReductionSpecification) -> bool:
    """Whether scores of a run may be copied or predicted: its optimum must be that of its own set."""
    return reduction.uses_map or reduction.predicts


def _settled(given: str | ReductionSpecification) -> ReductionSpecification:
    """Returns a reduction with its number of sets to confirm: stored specifications have every field, so none is a default there."""
    reduction = given if isinstance(given, ReductionSpecification) else validated(ReductionSpecification, {"mode": given})
    if "confirm" in reduction.model_fields_set or not _confirms(reduction):
        return reduction
    return reduction.model_copy(update={"confirm": CONFIRMED})


def _campaign(
    specification: ComparisonSpecification,
    name: str,
    optimizer: ComparedOptimizer,
    conditions: Conditions,
    reduction: ReductionSpecification,
) -> CampaignSpecification:
    chosen = optimizer.model_dump(exclude={"label"})
    chosen |= {"population": conditions.population, "iterations": specification.iterations, "start": specification.start}
    document = {
        **specification.model_dump(include=_SHARED),
        "name": name,
        "optimizer": chosen | {"seed": conditions.seed},
        "reduction": reduction.model_dump(),
    }
    if not (reduction.uses_map or reduction.narrow):  # useless to the run, and its cells would count
        document["sensitivity"] = None
    return validated(CampaignSpecification, document)


_SHARED = {
    *("priority", "problem", "catalogue", "parameters", "fixed", "baseline", "weights"),
    *("driving_function", "vehicle", "evaluator", "sensitivity"),
}


def _check_lists(specification: ComparisonSpecification, diagnostics: Diagnostics) -> None:
    count = (
        len(specification.optimizers)
        * len(specification.populations)
        * len(specification.seeds)
        * len(specification.reductions)
    )
    if count > LARGEST_RUNS:
        remedy = f"at most {LARGEST_RUNS:,}; give fewer optimizers, populations, seeds or reductions"
        diagnostics.add("", f"optimizers x populations x seeds x reductions are {count:,} runs", remedy)
    _check_unique("populations", specification.populations, diagnostics)
    _check_unique("seeds", specification.seeds, diagnostics)
    reductions = [_settled(reduction) for reduction in specification.reductions]
    _check_unique("reductions", [reduction_label(reduction) for reduction in reductions], diagnostics)
    if specification.sensitivity is None and any(reduction.uses_map for reduction in reductions):
        remedy = "ask for a sensitivity analysis, name a map, or leave `influence` and `both` out"
        diagnostics.add("sensitivity", "reductions `influence` and `both` need an influence map", remedy)
    seen: dict[str, int] = {}
    for index, optimizer in enumerate(specification.optimizers):
        label = optimizer.label or optimizer.kind
        if label in seen:
            message = f"it is called {label!r} as optimizers[{seen[label]}] is"
            diagnostics.add(f"optimizers[{index}].label", message, "list it once, or give each a label of its own")
        seen.setdefault(label, index)
        for name in optimizer.model_extra or {}:
            if name in COMMON:
                message = "all optimizers have the same here"
                diagnostics.add(f"optimizers[{index}].{name}", message, f"give it in `{COMMON[name]}`")
            elif name == "start_sets":
                diagnostics.add(f"optimizers[{index}].{name}", "all optimizers begin with the same sets here", "leave it out")


def _check_unique(field: str, values: Sequence[object], diagnostics: Diagnostics) -> None:
    for index, value in enumerate(values):
        if value in values[:index]:
            diagnostics.add(f"{field}[{index}]", f"{value} is listed twice", "list each once")


def _here(problem: Problem, optimizer: int, reduction: int) -> Problem:
    """Moves a problem of a run's campaign to the field of the comparison."""
    field = re.sub(r"^optimizer(?=\.|$)", f"optimizers[{optimizer}]", problem.field)
    field = re.sub(r"^reduction(?=\.|$)", f"reductions[{reduction}]", field)
    return Problem(field, problem.message, problem.remedy)
