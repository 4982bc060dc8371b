"""Resolves a specification against the installed plug-ins and the stored problems.

`POST /campaigns`, `?validate_only=true`, `submit --dry-run` and the dispatcher use it. It reports every problem at once, each with its
field and a remedy. `api.submission` then checks the server's limits, and `stages` check the campaigns that a study names as its source.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from math import ceil
from typing import Any

import numpy as np

from drivecal.analysis.goals import Goals, normalised
from drivecal.analysis.replicates import FEWEST_REPORTING, KEPT, choosing, fewest, kept_back, rate_bounds
from drivecal.campaigns.resolve import resolvers
from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.goals import check_reuse, find_goals, normalise_weights, note_lost
from drivecal.campaigns.resolve.optimizer import Optimization, check_abilities, choose_optimizer, note_search, settled_search
from drivecal.campaigns.resolve.spaces import (
    fixed_to_document,
    free_values,
    given_set,
    notes_off_grid,
    search_parameters,
    search_space,
    space_to_document,
)
from drivecal.campaigns.resolve.workbench import BundleSource, Workbench, bench_of, find_workbench, installed_bundles
from drivecal.contracts.campaign import ExpectedRuns
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.specification import (
    LARGEST_REPLICATES,
    CampaignSpecification,
    EvaluationSpecification,
    ProblemSpecification,
    ReductionSpecification,
    SensitivitySpecification,
    VariantSpecification,
)
from drivecal.contracts.work import Batch, Cell
from drivecal.domain.constraints import Constraints
from drivecal.domain.errors import Diagnostics, InvalidInputError, Problem
from drivecal.domain.parameters import Indices, Parameter, ParameterSet, ParameterSpace
from drivecal.domain.setups import base_of
from drivecal.reduction.assignment import LIKELY
from drivecal.reduction.lots import smallest_plan
from drivecal.sensitivity.analysis import SensitivityAnalysis


@dataclass(frozen=True)
class Variants:
    """Weights of each variant by scenario, of sum 1; none without variants. A scenario with the vehicle of a variant is a scenario of its
    own, `S1@eu`; variants with equal vehicles share it."""

    shares: Mapping[str, Mapping[str, float]]
    weights: Mapping[str, float]
    """By scenario, in their mean; all that are simulated, in the catalogue's order."""
    vehicles: Mapping[str, Mapping[str, float]]
    """Values of the side conditions in scenarios with another vehicle than the campaign's."""


def find_variants(
    specification: CampaignSpecification, weights: Mapping[str, float], workbench: Workbench, diagnostics: Diagnostics
) -> Variants:
    """Returns the variants of a campaign whose scenarios have these weights."""
    wanted = specification.variants
    if not wanted or not weights:
        if specification.common != "mean" and not wanted:
            diagnostics.add("common", "the campaign has no variants", "leave it out, or give variants")
        return Variants({}, weights, {})
    for place, given in enumerate(specification.objectives or ()):
        if place:
            diagnostics.add(f"objectives[{place}]", "variants have one objective", "leave it out")
        if given.scenarios != "all" or given.weights:
            diagnostics.add(f"objectives[{place}]", "the variants have scenarios and weights", "give them in `variants`")
    values: list[Mapping[str, float]] = [workbench.values]
    suffixes, vehicles, shares = [""], dict[str, Mapping[str, float]](), dict[str, dict[str, float]]()
    for name, variant in wanted.items():
        own = workbench.vehicles.get(name, workbench.values)
        if own not in values:
            values.append(own)
            suffixes.append(f"@{name}")
        suffix = suffixes[values.index(own)]
        shares[name] = {scenario + suffix: share for scenario, share in _shares(name, variant, weights, diagnostics).items()}
        vehicles |= {scenario: own for scenario in shares[name] if suffix}
    if vehicles and specification.robustness is not None:
        remedy = "leave it out, and give robustness.sets in a campaign with the vehicle of one variant"
        diagnostics.add("robustness", "it varies one vehicle, and variants have others", remedy)
    listed = [scenario + suffix for scenario in weights for suffix in suffixes]
    simulated = {base_of(each) for own in shares.values() for each in own}
    if left_out := [scenario for scenario in weights if scenario not in simulated]:
        diagnostics.notes.append(f"not simulated because no variant gives them a weight: {', '.join(left_out)}")
    return Variants(shares, normalised({each: sum(own.get(each, 0.0) for own in shares.values()) for each in listed}), vehicles)


def _shares(name: str, given: VariantSpecification, weights: Mapping[str, float], diagnostics: Diagnostics) -> dict[str, float]:
    """Returns the weights of a variant by scenario of the problem, of sum 1."""
    listed = list(weights) if given.scenarios == "all" else given.scenarios
    for place, scenario in enumerate(listed):
        if scenario not in weights:
            field, message = f"variants.{name}.scenarios[{place}]", f"the campaign does not simulate a scenario {scenario!r}"
            diagnostics.add(field, message, nearest(scenario, list(weights)))
    for scenario in given.weights:
        if scenario not in listed:
            field = f"variants.{name}.weights.{scenario}"
            diagnostics.add(field, "it is no scenario of the variant", nearest(scenario, listed))
    own = dict.fromkeys(weights, 1.0) | given.weights if given.weights else weights
    return normalised({scenario: own[scenario] for scenario in weights if scenario in listed})


def goals_of_variants(specification: CampaignSpecification, goals: Goals, variants: Variants) -> tuple[Goals, dict[str, Goals]]:
    """Returns the goals of the best common set, and the goals of each variant in its scenarios."""
    if not variants.shares:
        return goals, {}
    objective, bounds = goals.objectives[0], goals.bounds
    made = {}
    for name, shares in variants.shares.items():
        of = [shares if bound.value.change is not None else bound.shares for bound in bounds]
        held = [normalised({each: share for each, share in own.items() if each in shares}) for own in of]
        kept = tuple(replace(bound, shares=own) for bound, own in zip(bounds, held, strict=True) if own)
        made[name] = Goals((replace(objective, shares=shares),), kept)
    if specification.common == "worst" or objective.aggregate.kind != "mean":
        combined = replace(objective, variants=tuple(variants.shares.values()), worst=specification.common == "worst")
        return Goals((combined,), bounds), made
    return goals, made


@dataclass(frozen=True)
class CalibrationProblem:
    """A campaign that can run."""

    specification: CampaignSpecification
    bench: Bench
    space: ParameterSpace
    weights: Mapping[str, float]
    """Normalised to a sum of 1, by scenario; scenarios of weight 0 are left out (Eq. 6)."""
    optimization: Optimization | None
    """None without a search."""
    baseline: ParameterSet | None
    start_sets: tuple[ParameterSet, ...]
    """The sets that the start population must hold, each once: the baseline, then sets from expert knowledge."""
    robust_sets: tuple[ParameterSet, ...]
    """The sets that the robustness stage always examines."""
    notes: tuple[str, ...]
    constraints: Constraints
    """Constraints over the parameters; none for a plug-in without."""
    goals: Goals
    """Objectives and constraints; by default the weighted mean of the bench's score."""
    variants: Mapping[str, Goals] = field(default_factory=dict)
    """Objective and constraints of each variant."""

    def analysis(self) -> SensitivityAnalysis | None:
        """A new sensitivity analysis; None if the specification names a map or wants no analysis."""
        wanted = self.specification.sensitivity
        if not isinstance(wanted, SensitivitySpecification):
            return None
        return SensitivityAnalysis(self.space, self.scenarios, wanted, self.bench.scale, self.constraints)

    @cached_property
    def search_constraints(self) -> Constraints:
        """The constraints of the search: over the parameters, and limits of changes from a set."""
        return replace(self.constraints, limits=self.goals.limits)

    @property
    def policy(self) -> ReductionSpecification:
        """How the search's cells may be answered. A search by the cell has models of its own, so that no prediction answers its cells, and
        asks for so few at once that a lot of references would be simulated whole. A random simulator's cells have runs of their own."""
        chosen, reduction = self.optimization, self.specification.reduction
        mode = reduction.mode
        if mode != "off" and (self.bench.is_random or chosen is None or not chosen.has_populations):
            mode = "influence" if reduction.uses_map and reduction.max_error >= 1.0 and not self.bench.is_random else "exact"
        return reduction.model_copy(update={"mode": mode})

    def doubts_about_map(self) -> tuple[str, ...]:
        """Returns notes if the influence map answers few cells, or none of a search by the cell, and if its analysis does not pay."""
        if self.optimization is None or not self.specification.reduction.uses_map:
            return ()
        runs, limit, notes = self.expected_runs(), self.specification.reduction.max_error, []
        saved = round(LIKELY * runs.calibration_at_most) if self.policy.uses_map else 0
        if saved and limit < 1.0:
            plan = smallest_plan(max(1, round(LIKELY * self.optimization.population)), limit, 0)
            saved = round(saved * (plan.size - plan.sample) / plan.size)
            if 2 * plan.sample > plan.size:
                sampled = f"a lot of some {plan.size} cells has a sample of {plan.sample} (`max_error` {limit:g})"
                notes.append(f"the influence map will save little: {sampled}; a larger population or `max_error` saves more")
        if not self.policy.uses_map:
            why = "checks in lots would simulate each cell that this search asks for"
            why = "runs of a random simulator answer equal sets under equal seeds only" if self.bench.is_random else why
            notes.append(f"the influence map answers no cell: {why}")
        if runs.sensitivity > saved:
            words = f"it would probably save {saved:,} simulations, and takes at most {runs.sensitivity_at_most:,}"
            notes.append(f"the sensitivity analysis does not pay: {words}; leave it out, or let other campaigns use its map")
        return tuple(notes)

    @property
    def scenarios(self) -> tuple[str, ...]:
        """The ids of the simulated scenarios, in the catalogue's order."""
        return tuple(self.weights)

    @property
    def least_replicates(self) -> int:
        """The number of seeds under which the search runs each set."""
        return self.specification.replicates.least if self.bench.is_random else 1

    @property
    def scenarios_of_variants(self) -> int:
        """The number of scenarios of each variant, in sum."""
        return sum(len(goals.objectives[0].shares) for goals in self.variants.values())

    @property
    def baseline_seeds(self) -> range:
        """The seeds of the best set's report that the baseline of a random simulator runs under as well, or nothing tells which is better;
        none if that would take more than a tenth of the budget, and for fronts and quantiles."""
        wanted, budget = self.specification.replicates, None if self.optimization is None else self.optimization.budget
        seeds = range(choosing(wanted.most) + 1, wanted.most + 1)[:FEWEST_REPORTING]
        affordable = budget is None or budget.simulations is None or 10 * len(seeds) * len(self.scenarios) <= budget.simulations
        is_compared = self.baseline is not None and len(self.goals.objectives) == 1 and wanted.level is None
        return seeds if is_compared and self.bench.is_random and affordable else seeds[:0]

    @property
    def fewest_seeds(self) -> int:
        """Number of seeds that show all rates, for each variant too, if no run is beyond a limit."""
        return max(goals.fewest_seeds for goals in (self.goals, *self.variants.values()))

    @property
    def search(self) -> Optimization:
        """The chosen optimizer. Raises ValueError without one."""
        if self.optimization is None:
            raise ValueError("the campaign has no search")
        return self.optimization

    def search_simulations(self, *, varies: bool = False) -> int | None:
        """Returns the simulations of the budget that the search may use; None without a limit. `varies`: equal runs have differed."""
        budget, is_random = None if self.optimization is None else self.optimization.budget, varies or self.bench.is_random
        if self.optimization is None or budget is None or budget.simulations is None or not is_random:
            return None if budget is None else budget.simulations
        by_cell, most = not self.optimization.has_populations, self.specification.replicates.most
        shown, of_variants = self.fewest_seeds, self.scenarios_of_variants
        kept = kept_back(budget.simulations, len(self.scenarios), most, shown, of_variants, by_cell=by_cell)
        return budget.simulations - kept - len(self.baseline_seeds) * len(self.scenarios)

    @property
    def start_indices(self) -> Indices:
        """Grid indices of the start sets, shape (n, n_searched)."""
        rows = [self.space.indices(parameter_set.values) for parameter_set in self.start_sets]
        return np.array(rows, dtype=np.int64).reshape(len(rows), len(self.space.searched))

    def expected_runs(self) -> ExpectedRuns:
        """The number of simulations if no cell can be answered without one."""
        chosen, analysis = self.optimization, self.analysis()
        proposed = requested = 0
        if chosen is not None:
            proposed, requested = chosen.expected_cells(len(self.scenarios))
            budget = None if chosen.budget is None else chosen.budget.simulations
            if self.bench.is_random and chosen.iterations is not None:
                further = requested * (self.least_replicates - 1)
                if (most := self.specification.replicates.most) > 1:  # what a budget would keep for them
                    least = fewest(len(self.scenarios), most, self.fewest_seeds, self.scenarios_of_variants)
                    reports = (most + len(self.baseline_seeds)) * len(self.scenarios)
                    further += max(least, ceil(KEPT / (1.0 - KEPT) * (requested + further))) + reports
                proposed, requested = proposed + further, requested + further
            requested = requested if budget is None else min(requested, budget)
        phases = {} if analysis is None else analysis.expected_runs()
        return ExpectedRuns(
            problem=self.specification.problem,
            sensitivity=phases.get("intervals", 0) * len(self.scenarios),
            sensitivity_at_most=sum(phases.values()) * len(self.scenarios),
            calibration_proposed=proposed,
            calibration_at_most=requested,
            robustness=self._robustness_runs(),
            validation=self._validation_runs(),
            notes=list(self.notes),
        )

    def _robustness_runs(self) -> int:
        wanted = self.specification.robustness
        if wanted is None:
            return 0
        searched = self.optimization is not None or wanted.of is not None
        sets = len(self.robust_sets) + (wanted.solutions if searched else 0)
        return sets * len(self.scenarios) * ((wanted.samples if self.bench.is_random else 1) + wanted.steps * wanted.samples)

    def _validation_runs(self) -> int:
        wanted = self.specification.validation
        return 0 if wanted is None or wanted.of is not None else wanted.samples * (1 + wanted.references) * len(self.scenarios)

    def resolution(self) -> dict[str, Any]:
        """Returns what must not change before the campaign ends: setups, evaluator, space; JSON-ready.

        `resolved_spec.ResolvedSpec` is what it means once the campaign has been taken up.
        """
        fixed = fixed_to_document(self.space.fixed)
        resolution = _resolution(self.bench, self.space.parameters) | {"fixed": fixed, "weights": dict(self.weights)}
        shapes = self.bench.bundle.manifest.shapes.items()
        resolution |= {"shapes": {name: each.document | {"axes": [list(axis) for axis in each.axes]} for name, each in shapes}}
        resolution |= {"goals": self.goals.to_json()}
        return resolution | {"variants": {name: goals.to_json() for name, goals in self.variants.items()}}


@dataclass(frozen=True)
class EvaluationProblem:
    """A parameter set to simulate in one or more scenarios."""

    specification: EvaluationSpecification
    bench: Bench
    """With the first seed."""
    parameter_set: ParameterSet
    seeds: tuple[int, ...]
    notes: tuple[str, ...] = ()

    def resolution(self) -> dict[str, Any]:
        """See `CalibrationProblem.resolution`."""
        return _resolution(self.bench, self.bench.parameters)


def _resolution(bench: Bench, space: Sequence[Parameter]) -> dict[str, Any]:
    return {
        "setups": {scenario: setup.fingerprint for scenario, setup in bench.setups.items()},
        "evaluator": bench.evaluator_id,
        "scale": asdict(bench.scale),
        "space": space_to_document(space),
    }


def resolve(specification: CampaignSpecification, bundles: BundleSource = installed_bundles) -> CalibrationProblem:
    """Resolves a campaign's specification. Raises InvalidInputError with every problem.

    The resolved specification names a bundle by its digest, so that a later push of the same name changes nothing.
    """
    diagnostics = Diagnostics()
    workbench = find_workbench(specification, bundles, diagnostics)
    shapes = {} if workbench.function is None else workbench.function.shapes
    weights, notes = normalise_weights(specification.weights, workbench.scenarios, diagnostics)
    variants = find_variants(specification, weights, workbench, diagnostics)
    weights = dict(variants.weights)
    optimization = choose_optimizer(specification, len(weights), diagnostics)
    if notes and (specification.objectives or specification.constraints):
        notes += ("objectives and constraints leave these scenarios out as well",)
    notes += workbench.notes
    space = None if workbench.function is None else search_space(specification, workbench.function, diagnostics)
    constraints = None if space is None else resolvers.find_constraints(workbench.function, space, diagnostics)
    if specification.baseline is None:
        baseline, more = resolvers.own_baseline(workbench.baseline, constraints, shapes)
        notes += more
    else:
        baseline = given_set(specification.baseline, constraints, "baseline", diagnostics, shapes)
    known = replace(workbench.known, constraints=constraints, baseline=baseline)
    goals = find_goals(specification, known, weights, diagnostics) if known.scores and weights else Goals(())
    own_goals: dict[str, Goals] = {}
    if not diagnostics.problems:
        goals, own_goals = goals_of_variants(specification, goals, variants)
    reduction, on_reuse = check_reuse(specification.reduction, goals, diagnostics, has_variants=bool(variants.shares))
    specification = specification.model_copy(update={"reduction": reduction})
    check_abilities(optimization, constraints, goals, diagnostics)
    notes += note_search(optimization, constraints)
    population = optimization.population if optimization is not None and optimization.has_populations else None
    within = replace(constraints, limits=goals.limits) if constraints is not None else None
    start_sets = resolvers.find_start_sets(specification, baseline, within, diagnostics, population, shapes)
    robust_sets = resolvers.find_robust_sets(specification, workbench.varied, constraints, diagnostics, shapes)
    resolvers.check_validation(specification, diagnostics)
    analysed = specification.sensitivity
    if constraints is not None and isinstance(analysed, SensitivitySpecification):
        diagnostics.attempt(lambda: SensitivityAnalysis(constraints.space, tuple(weights), analysed, constraints=constraints))
    make, space, allowed = diagnostics.found(workbench.make), diagnostics.found(space), diagnostics.found(constraints)
    specification = specification.model_copy(update=dict(workbench.settled) | settled_search(specification, optimization))
    bench = replace(make(weights, variants.vehicles), repeat=specification.reduction.repeat)
    if specification.robustness is not None:
        specification = specification.model_copy(update={"robustness": specification.robustness.on(bench.scale)})
    resolvers.check_units(specification, bench.scale, diagnostics)
    notes += resolvers.note_threshold(specification, bench.scale)
    if bench.is_random:
        notes += note_lost(goals)
    else:
        notes += on_reuse + (resolvers.note_predictions(specification, bench.scale) if population is not None else ())
    sets = baseline, start_sets, robust_sets
    problem = CalibrationProblem(specification, bench, space, weights, optimization, *sets, notes, allowed, goals, own_goals)
    _check_rates(problem, diagnostics)
    diagnostics.raise_if_any()
    cells, first = problem.search_simulations(), max(1, population or 0) * problem.least_replicates * len(problem.scenarios)
    if cells is not None and (cells < first if population is None else cells <= first):
        what = "a set takes" if population is None else f"its first population of {population:,} sets may take"
        notes += (f"the search may take {cells:,} simulations, and {what} {first:,}",)
    return replace(problem, notes=(*notes, *diagnostics.notes, *problem.doubts_about_map()))


def _check_rates(problem: CalibrationProblem, diagnostics: Diagnostics) -> None:
    """Adds problems for rates of a simulator that is not random, and for rates that the replicates or the budget cannot show."""
    most, budget = problem.specification.replicates.most, None if problem.optimization is None else problem.optimization.budget
    for place, bound in enumerate(problem.goals.bounds):
        if bound.rate is None:
            continue
        held = [own for goals in (problem.goals, *problem.variants.values()) for own in goals.bounds]
        scenarios = min(len(own.shares) for own in held if replace(own, shares=bound.shares) == bound)
        field, seeds, needed = f"constraints[{place}].rate", choosing(most), ceil(bound.fewest_runs / scenarios)
        takes = f"a rate of {bound.rate:g} takes {bound.fewest_runs:,} runs without one beyond the limit"
        kept = 2 * fewest(len(problem.scenarios), most, needed)
        if not problem.bench.is_random:
            message = "the simulator is not random, and each set has one run in a scenario"
            diagnostics.add(field, message, "leave it out, or give `random: true` in problem.yaml")
        elif needed > seeds:
            enough = next((more for more in range(most, LARGEST_REPLICATES + 1) if choosing(more) >= needed), None)
            shown = (seeds if enough else choosing(LARGEST_REPLICATES)) * scenarios
            least = f"a rate of at least {1.0005 * rate_bounds(0, shown, bound.confidence)[1]:.4g}"  # never rounded down
            remedy = (
                f"replicates.most of at least {enough}, or {least}"
                if enough
                else f"{least} and replicates.most: {LARGEST_REPLICATES}"
            )
            diagnostics.add(field, f"{takes}, and {seeds} of {most} seeds choose a set", f"give {remedy}")
        elif budget is not None and budget.simulations is not None and budget.simulations < kept:
            message = f"{takes}, {needed:,} seeds, and half of the budget at most is kept for them and for the report"
            fewer = (n for n in range(most - 1, 1, -1) if choosing(n) >= needed)
            enough = next((n for n in fewer if 2 * fewest(len(problem.scenarios), n, needed) <= budget.simulations), None)
            remedy = "or a higher rate" if enough is None else f"or replicates.most: {enough}"
            diagnostics.add(field, message, f"give budget.simulations of at least {kept:,}, {remedy}")


def resolve_evaluation(specification: EvaluationSpecification, bundles: BundleSource = installed_bundles) -> EvaluationProblem:
    """Resolves a single evaluation. Its values may lie between grid points, within the driving function's limits."""
    diagnostics = Diagnostics()
    workbench = find_workbench(specification, bundles, diagnostics)
    scenarios = workbench.scenarios
    if specification.scenario is not None:
        if specification.scenario in scenarios:
            scenarios = (specification.scenario,)
        elif scenarios:
            diagnostics.add("scenario", f"there is no scenario {specification.scenario!r}", f"one of {', '.join(scenarios)}")
    offered = workbench.function
    values = {} if offered is None else free_values(specification.parameters, offered, "parameters", diagnostics)
    make, function = diagnostics.found(workbench.make), diagnostics.found(offered)
    parameter_set = ParameterSet.of(values)
    space = ParameterSpace(search_parameters(None, function))
    Constraints(space, function.constraints).check(parameter_set, "parameters")
    specification = specification.model_copy(update=dict(workbench.settled) | {"parameters": parameter_set.floats})
    bench = make(scenarios, {})
    given = specification.seeds
    seeds = tuple(range(1, given + 1) if isinstance(given, int) else sorted(set(given)))
    bench = bench.seeded(seeds[0])
    if bench.bundle.manifest.simulator.deterministic and not bench.is_random and isinstance(given, int) and given > 1:
        raise InvalidInputError(Problem("seeds", "the simulator is deterministic: all seeds give one result", "leave it out"))
    notes = (*diagnostics.notes, *notes_off_grid(values, function))
    if bench.bundle.manifest.claims:
        notes += ("`added`, `removed` and `renamed` of problem.yaml answer once a campaign has checked them",)
    return EvaluationProblem(specification, bench, parameter_set, seeds, notes)


def trial() -> Batch:
    """Returns the cell that a worker simulates before it counts as ready: the middle of the default space in its first scenario.

    It compiles all kernels, which can exceed a batch's time limit. A worker with another version or without a working SUMO refuses it.
    Raises InvalidInputError if the coordinator lacks a plug-in.
    """
    bench = bench_of(ProblemSpecification())
    space = ParameterSpace(bench.parameters)
    middle = space.parameter_set((space.n_values // 2).tolist())
    return Batch(next(iter(bench.requests.values())), (Cell(0, middle.floats),))
