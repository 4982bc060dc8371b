"""Comparisons: ordinary campaigns with a common tag, made from one file, and the analysis of what they found.

The campaigns of a comparison are isolated: they see no results of others, so that neither their order nor earlier results change what
they find or count. Cells that several of them request, or that were simulated before, are simulated once all the same, except for cells
whose result is being stored at that moment: this saves work, and does not show in the counts.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice, product
from typing import Any

from sqlalchemy import Connection

from drivecal.analysis import comparison as analysis
from drivecal.analysis.comparison import Conditions, Course
from drivecal.campaigns.resolve.optimizer import BEGINNINGS, WITHOUT_POPULATIONS
from drivecal.campaigns.resolve.problem import CalibrationProblem, resolve
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.resolve.workbench import BundleSource, installed_bundles
from drivecal.contracts.comparison import LARGEST_RUNS, ComparedOptimizer, ComparedRun, Comparison, ComparisonSpecification
from drivecal.contracts.input_errors import validated
from drivecal.contracts.specification import CampaignSpecification, ReductionSpecification
from drivecal.contracts.tables import Generation
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import Diagnostics, InvalidInputError, NotFoundError, Problem, attempted, problems_of
from drivecal.domain.setups import digest
from drivecal.optimizers.built_in import EXTERNAL
from drivecal.plugins import registry
from drivecal.storage import campaigns, evaluations, generations
from drivecal.storage.campaigns import StoredCampaign

COMMON = {"population": "populations", "iterations": "iterations", "start": "start", "seed": "seeds"}
"""Settings that the comparison chooses for every optimizer, and their fields."""
CONFIRMED = 100
"""Most sets of a campaign with references or predictions that are simulated after its search, unless `confirm` is given: a dozen is many.
A campaign for which they were too few notes it."""
_SHARED = {
    *("priority", "problem", "catalogue", "parameters", "fixed", "baseline", "weights"),
    *("driving_function", "vehicle", "evaluator", "sensitivity"),
}


@dataclass(frozen=True, slots=True)
class ComparisonProblem:
    """A comparison that can run: the specifications of its campaigns, and the resolved ones of the first seed, which stand for all."""

    specification: ComparisonSpecification
    runs: Sequence[CampaignSpecification]
    problems: Sequence[CalibrationProblem]

    @property
    def proposed(self) -> int:
        """The cells that all campaigns together propose."""
        return self._total("calibration_proposed")

    @property
    def at_most(self) -> int:
        """The simulations of all campaigns together if they share no cell."""
        return self._total("calibration_at_most")

    def _total(self, calibration: str) -> int:
        expected = [problem.expected_runs() for problem in self.problems]
        cells: int = sum(getattr(runs, calibration) + runs.sensitivity_at_most for runs in expected)
        return len(self.specification.seeds) * cells


def tag_of(name: str, key: str) -> str:
    """Returns the tag of a comparison's campaigns; equal names and request keys have the same."""
    words = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:27].rstrip("-") or "comparison"
    return f"{words}-{digest(key.encode())[:12]}"


def keys_of(specification: ComparisonSpecification, key: str) -> list[str]:
    """Returns the request keys of a comparison's campaigns, in order; the first is the request's own."""
    count = sum(1 for _ in islice(_places(specification), LARGEST_RUNS))  # `resolve_comparison` refuses more
    return [key, *(digest(f"{key} {place}".encode()) for place in range(1, count))]


def runs_of(specification: ComparisonSpecification) -> list[CampaignSpecification]:
    """Returns the campaigns in order: by optimizer, population, seed, reduction. Depends on the specification alone."""
    optimizers, reductions = specification.optimizers, [_settled(each) for each in specification.reductions]
    optimizer_labels = analysis.labels([optimizer.model_dump() for optimizer in optimizers], "kind")
    reduction_labels = analysis.labels([reduction.model_dump() for reduction in reductions], "mode")
    runs = []
    for chosen, population, seed, reduced in _places(specification):
        several = f", {reduction_labels[reduced]}" if len(reductions) > 1 else ""
        size = "" if population is None else f", population {population}"
        name = f"{specification.name[:90]}: {optimizer_labels[chosen][:60]}{size}, seed {seed}{several}"[:200]
        runs.append(_campaign(specification, name, optimizers[chosen], population, seed, reductions[reduced]))
    return runs


def _places(specification: ComparisonSpecification) -> Iterator[tuple[int, int | None, int, int]]:
    """Yields place of the optimizer, population, if it has any, seed and place of the reduction of each campaign, in order."""
    for place, optimizer in enumerate(specification.optimizers):
        populations = _populations(specification, optimizer)
        for population, seed, reduction in product(populations, specification.seeds, range(len(specification.reductions))):
            yield place, population, seed, reduction


def _populations(specification: ComparisonSpecification, optimizer: ComparedOptimizer) -> Sequence[int | None]:
    with suppress(InvalidInputError):  # an unknown optimizer is refused later
        if isinstance(registry.optimizer(optimizer.kind), WITHOUT_POPULATIONS):
            return [None]
    return specification.populations


def _campaign(
    specification: ComparisonSpecification,
    name: str,
    optimizer: ComparedOptimizer,
    population: int | None,
    seed: int,
    reduction: ReductionSpecification,
) -> CampaignSpecification:
    common: dict[str, Any] = {"seed": seed}
    if population is not None:
        common |= {"population": population, "start": specification.start}
        common |= {"iterations": specification.iterations} if specification.budget is None else {}
    document = {
        "budget": None if specification.budget is None else specification.budget.model_dump(),
        **specification.model_dump(include=_SHARED),
        "name": name,
        "optimizer": optimizer.model_dump() | common,
        "reduction": reduction.model_dump(),
    }
    if not reduction.uses_map:  # useless to the campaign, and its cells would count
        document["sensitivity"] = None
    return validated(CampaignSpecification, document)


def _settled(given: str | ReductionSpecification) -> ReductionSpecification:
    """Returns an isolated reduction with its number of sets to confirm."""
    reduction = given if isinstance(given, ReductionSpecification) else validated(ReductionSpecification, {"mode": given})
    settled: dict[str, Any] = {"isolated": True}
    if "confirm" not in reduction.model_fields_set and (reduction.uses_map or reduction.predicts):
        settled["confirm"] = CONFIRMED
    return reduction.model_copy(update=settled)


def resolve_comparison(specification: ComparisonSpecification, bundles: BundleSource = installed_bundles) -> ComparisonProblem:
    """Resolves a comparison's specification. Raises InvalidInputError with every problem at its field."""
    diagnostics = Diagnostics()
    _check_lists(specification, diagnostics)
    diagnostics.raise_if_any()
    resolved = list[CalibrationProblem]()
    for run, (optimizer, _, seed, reduction) in zip(runs_of(specification), _places(specification), strict=True):
        if seed == specification.seeds[0]:
            made = attempted(resolve, run, bundles)
            diagnostics.problems.extend(_moved(problem, optimizer, reduction) for problem in problems_of(made))
            resolved += [made] if isinstance(made, CalibrationProblem) else []
    diagnostics.problems = list(dict.fromkeys(diagnostics.problems))
    diagnostics.raise_if_any()
    settled = [_settled(reduction) for reduction in specification.reductions]
    specification = specification.model_copy(update={"problem": resolved[0].specification.problem, "reductions": settled})
    return ComparisonProblem(specification, runs_of(specification), resolved)


def _check_lists(specification: ComparisonSpecification, diagnostics: Diagnostics) -> None:
    searches = sum(len(_populations(specification, optimizer)) for optimizer in specification.optimizers)
    count = searches * len(specification.seeds) * len(specification.reductions)
    if count > LARGEST_RUNS:
        remedy = f"at most {LARGEST_RUNS:,}; give fewer optimizers, populations, seeds or reductions"
        diagnostics.add("", f"these optimizers, populations, seeds and reductions are {count:,} campaigns", remedy)
    reductions = [_settled(reduction) for reduction in specification.reductions]
    _check_unique("optimizers", specification.optimizers, diagnostics)
    _check_unique("populations", specification.populations, diagnostics)
    _check_unique("seeds", specification.seeds, diagnostics)
    _check_unique("reductions", [reduction.model_dump() for reduction in reductions], diagnostics)
    if specification.sensitivity is None and any(reduction.uses_map for reduction in reductions):
        remedy = "ask for a sensitivity analysis, name a map, or leave `influence` and `both` out"
        diagnostics.add("sensitivity", "reductions `influence` and `both` need an influence map", remedy)
    for index, optimizer in enumerate(specification.optimizers):
        if optimizer.kind == EXTERNAL.name:
            diagnostics.add(f"optimizers[{index}].kind", "others propose its sets", "compare such campaigns by a common tag")
        for name in optimizer.model_extra or {}:
            if name in COMMON:
                message = "all optimizers have the same here"
                diagnostics.add(f"optimizers[{index}].{name}", message, f"give it in `{COMMON[name]}`")
            elif name in BEGINNINGS:
                diagnostics.add(f"optimizers[{index}].{name}", "all optimizers begin with the same sets here", "leave it out")


def _check_unique(field: str, values: Sequence[object], diagnostics: Diagnostics) -> None:
    for index, value in enumerate(values):
        if value in values[:index]:
            diagnostics.add(f"{field}[{index}]", "it is listed twice", "list each once")


def _moved(problem: Problem, optimizer: int, reduction: int) -> Problem:
    """Moves a problem of a campaign to the field of the comparison."""
    field = re.sub(r"^optimizer(?=\.|$)", f"optimizers[{optimizer}]", problem.field)
    field = re.sub(r"^reduction(?=\.|$)", f"reductions[{reduction}]", field)
    return Problem(field, problem.message, problem.remedy)


def compared(connection: Connection, tag: str) -> Comparison:
    """Compares the campaigns with a tag that have an optimizer, as far as they are. Raises NotFoundError without such a campaign."""
    page, _ = campaigns.page(connection, limit=LARGEST_RUNS, conditions=campaigns.having([tag]))
    whole = [campaign if campaign.spec else campaigns.by_sequence(connection, campaign.sequence) for campaign in reversed(page)]
    stored = [campaign for campaign in whole if campaign.spec.get("optimizer")]
    if not stored:
        raise NotFoundError("comparison", tag)
    is_random = any(evaluations.are_seeded(connection, campaign.sequence) for campaign in stored)
    pairs = zip(stored, _conditions(stored), strict=True)
    courses = [_course(connection, each, conditions, is_random=is_random) for each, conditions in pairs]
    sign = next((resolved_spec(campaign).goals.objectives[0].sign for campaign in stored if campaign.resolution is not None), 1)
    best = analysis.best_of((course.optimum for course in courses), sign)
    return Comparison(
        tag=tag,
        direction="maximise" if sign > 0 else "minimise",
        runs=[
            _run(campaign, course, success=None if is_random else analysis.succeeds(course, best, sign))
            for campaign, course in zip(stored, courses, strict=True)
        ],
        groups=analysis.groups(courses, sign),
    )


def _conditions(stored: Sequence[StoredCampaign]) -> list[Conditions]:
    """Returns the conditions of campaigns, by what their specifications differ in."""
    optimizers = [campaign.spec["optimizer"] for campaign in stored]
    own = {"population", "seed"}
    settings = [{name: value for name, value in optimizer.items() if name not in own} for optimizer in optimizers]
    reductions = analysis.labels([campaign.spec["reduction"] for campaign in stored], "mode")
    return [
        Conditions(label, optimizer["population"] or 0, optimizer["seed"], reduction)
        for label, optimizer, reduction in zip(analysis.labels(settings, "kind"), optimizers, reductions, strict=True)
    ]


def _course(connection: Connection, campaign: StoredCampaign, conditions: Conditions, *, is_random: bool) -> Course:
    iterations = generations.course(connection, campaign.sequence)
    searched = campaign.search is not None and campaign.search.ended_by is not None  # what follows confirms the best set
    return Course(
        campaign=campaign.id,
        conditions=conditions,
        iterations=iterations,
        surest=None if campaign.search is None else campaign.search.surest,
        confirmations=analysis.needed(campaign.cells) - sum(map(analysis.needed, iterations)) if searched else 0,
        is_random=is_random,
    )


def _run(campaign: StoredCampaign, course: Course, *, success: bool | None) -> ComparedRun:
    analysed = campaign.counts(StageName.SENSITIVITY)
    last = course.iterations[-1] if course.iterations else Generation(iteration=0)
    return ComparedRun.of(
        last,
        campaign=campaign.id,
        name=campaign.name,
        **course.conditions._asdict(),
        state=campaign.state,
        iterations=len(course.iterations),
        requested=campaign.cells.requested,
        simulations=course.simulated,
        confirmations=course.confirmations,
        analysis=analysed.requested - analysed.repeated,
        simulated_best=course.optimum,
        converged_at=course.converged_at,
        simulations_to_converge=course.simulations_to_converge,
        success=success,
        course=course.improvements,
    )
