"""The report of a comparison: Table 5, Figures 7 and 8 with all runs, and the effects of a reduction."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

from drivecal.contracts.campaign import Campaign
from drivecal.contracts.comparison import ComparedGroup, ComparedPair, ComparedRun, ReductionEffect
from drivecal.domain.scales import objective_text
from drivecal.report import PAGE
from drivecal.report.data import ComparisonData
from drivecal.report.figures.comparison import effects_figure, optima_figure, search_figures
from drivecal.report.folder import writable
from drivecal.report.markup import bullets, document, files, paragraph, table, verbatim
from drivecal.report.rows import Number, compared_groups, fixed, objective_number, percent, reduction_effect

SPECIFICATION = "comparison.json"
COUNTED = (
    "Each run sees the results of no other campaign, so what it asks for and finds does not depend on the others, nor on what was stored "
    "before. Simulations are cells without an answer among the run's own earlier ones: what the run would have taken alone on an empty "
    "database. What several runs have in common was simulated once, and is counted by each."
)
BELIEVED = (
    "If references answer cells, a search prefers sets whose scores are too good. So after the search its best set is simulated if "
    "scores of it are references', and the next one if it falls, until the best set owes nothing to a reference; that counts among the "
    "simulations. What is said of optima here, but for the searches' courses, is said of that set; the table of runs shows beside it "
    "what the search believed. Of a run that has not come that far, or is of a release that did not do so, it is the best set whose "
    "scores were all simulated, a lower bound."
)
CONVERGED = (
    "A run has converged in the iteration after which its best objective stayed as it was for at least 10 further ones; means "
    "are over the runs that have. As good as any: runs that found the best objective of the whole comparison."
)


def write_comparison(
    comparison: ComparisonData, tables: Mapping[str, Iterable[bytes]], folder: Path, *, page_alone: bool = False
) -> list[Path]:
    """Writes page, figures, the `tables` (CSV by name, in pieces) and the specification. Returns the written files, the page last.
    `page_alone`: writes the page only, without links to files.

    Raises InvalidInputError if a file cannot be written.
    """
    with writable(folder, page_alone=page_alone) as target:
        searches = [
            target.draw(figure)
            for figure in search_figures(comparison.runs, comparison.generations, comparison.campaign.scale.sign)
        ]
        searches.append(
            target.draw(optima_figure(comparison.runs)) if any(run.best is not None for run in comparison.runs) else ""
        )
        reduced = target.draw(effects_figure(comparison.pairs, comparison.effects)) if comparison.pairs else ""
        for name, pieces in tables.items():
            target.write(f"tables/{name}.csv", pieces)
        specification = json.dumps(comparison.campaign.spec, indent=2, ensure_ascii=False)
        target.write(SPECIFICATION, [specification.encode() + b"\n"])
        target.write(PAGE, [_page(comparison, searches, reduced, target.files).encode()])
    return target.written


def _page(comparison: ComparisonData, searches: Sequence[str], reduced: str, names: Sequence[str]) -> str:
    campaign = comparison.campaign
    several = len({group.reduction for group in comparison.groups}) > 1
    doubted = any(run.best != run.simulated_best or run.confirmations for run in comparison.runs)
    believed = [paragraph(BELIEVED)] if doubted else []
    sections = {
        "Summary": [paragraph(text, "key") for text in summary(comparison)],
        "Notes": [bullets(campaign.notes)] if campaign.notes else [],
        "Problem": [_problem(campaign)],
        "Optimizers": [
            _final_optima(comparison.groups, several=several),
            paragraph(CONVERGED),
            paragraph(COUNTED),
            *believed,
            *searches,
        ],
        "Reduction": [_effects(comparison.effects), reduced, _pairs(comparison.pairs)] if comparison.effects else [],
        "Runs": [_runs(comparison.runs, several=several)],
        "Again": [verbatim(f"drivecal compare-optimizers {SPECIFICATION} --wait")],
        "Files": [files(names)] if names else [],
    }
    ended = "" if campaign.ended_at is None else f", ended {campaign.ended_at:%Y-%m-%d %H:%M} UTC"
    spent = f"{campaign.seconds.wall:,.0f} s, CPU time of all simulations {campaign.seconds.simulating:,.0f} s"
    subtitle = f"comparison {campaign.id}, {campaign.state}{ended} after {spent}; drivecal {version('drivecal')}"
    return document(campaign.name, subtitle, (campaign.error, campaign.degraded), sections)


def summary(comparison: ComparisonData) -> list[str]:
    """Returns sentences that summarise the comparison."""
    sentences = []
    best = next((run.simulated_best for run in comparison.runs if run.success), None)
    if best is not None:
        groups: dict[str, list[ComparedRun]] = {}
        for run in comparison.runs:
            groups.setdefault(run.optimizer, []).append(run)
        shares = ", ".join(f"{name} in {sum(run.success for run in runs)} of {len(runs)} runs" for name, runs in groups.items())
        sentences.append(f"The best objective that any run found is {objective_text(best)}: {shares}.")
    for effect in comparison.effects:
        overall = effect.optimizer is None or sum(other.reduction == effect.reduction for other in comparison.effects) == 1
        if overall:
            sentences.append(_effect_sentence(effect))
    return sentences


def _effect_sentence(effect: ReductionEffect) -> str:
    different = effect.better + effect.worse
    interval = ""
    if effect.lower_95 is not None and effect.upper_95 is not None:
        interval = f" (95 % interval {objective_text(effect.lower_95, '+')} to {objective_text(effect.upper_95, '+')})"
    return (
        f"{effect.reduction} in the place of {effect.base}: in {effect.pairs} pairs of searches with the same seed, {effect.better} ended "
        f"with a better optimum, {effect.equal} with an equal and {effect.worse} with a worse one; the mean difference is "
        f"{objective_text(effect.mean_difference, '+')}{interval}, the sign test gives p = {effect.sign_test:.3g}"
        f"{'' if different else f', and at most {effect.different_upper_95:.0%} of such searches end elsewhere (95 %)'}. "
        f"It took {effect.simulations:,} simulations in the place of {effect.base_simulations:,}, {effect.saved_share:.1%} less."
    )


def _problem(campaign: Campaign) -> str:
    spec = campaign.spec
    fields = ("catalogue", "parameters", "fixed", "weights", "driving_function", "vehicle", "evaluator", "sensitivity")
    settings = [*fields, "optimizers", "populations", "seeds", "iterations", "start", "reductions"]
    rows = [[name, _plain(spec[name])] for name in settings if spec.get(name) not in (None, {}, [])]
    return table(["field", "value"], rows, "What was compared", wrap=True)


def _plain(value: object) -> str:
    """Returns a value as in a file, without missing parts."""
    if isinstance(value, str):
        return value
    if isinstance(value, list):
        return ", ".join(_plain(item) for item in value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name}: {_plain(item)}" for name, item in value.items() if item not in (None, {}, [])) + "}"
    return json.dumps(value)


def _final_optima(groups: Sequence[ComparedGroup], *, several: bool) -> str:
    header = ["optimizer", "size", *(["reduction"] if several else []), "best", "mean", "worst", "rating", "sets at best"]
    header += ["simulations", "converged", "in iteration", "after simulations", "as good as any"]
    caption = "Final optima over the seeds, by population size, and what they took"
    return table(header, compared_groups(groups, with_reduction=several), caption, wrap_header=True)


def _effects(effects: Sequence[ReductionEffect]) -> str:
    header = ["optimizer", "size", "reduction", "pairs", "difference", "95 % interval", "better", "equal", "worse"]
    header += ["p", "differ at most", "saved", "share"]
    rows = [
        [*reduction_effect(effect), effect.base_simulations - effect.simulations, percent(effect.saved_share, 1)]
        for effect in effects
    ]
    caption = (
        "Final optimum with a reduction less that without it, run by run with the same seed; p: of the exact sign test; differ at most: "
        "the share of searches that end elsewhere, with 95 % confidence; saved: simulations"
    )
    return table(header, rows, caption, wrap_header=True)


def _pairs(pairs: Sequence[ComparedPair]) -> str:
    header = ["optimizer", "population", "seed", "reduction", "optimum without", "with", "difference"]
    header += ["simulations without", "with", "saved"]
    rows = [
        [
            *(
                pair.optimizer,
                pair.population,
                pair.seed,
                pair.reduction,
                objective_number(pair.base_best),
                objective_number(pair.best),
            ),
            *(Number(objective_text(pair.difference, "+")), pair.base_simulations, pair.simulations, pair.saved),
        ]
        for pair in pairs
    ]
    return table(header, rows, "All pairs", wrap_header=True)


def _runs(runs: Sequence[ComparedRun], *, several: bool) -> str:
    """Returns columns that differ between rows, for a narrow table."""
    left_out = {
        "reduction": not several,
        "state": all(run.state == "succeeded" for run in runs),
        "believed": all(run.best == run.simulated_best for run in runs),
        "confirming": not any(run.confirmations for run in runs),
        "analysis": not any(run.analysis for run in runs),
    }
    columns: dict[str, Callable[[ComparedRun], object]] = {
        "optimizer": lambda run: run.optimizer,
        "size": lambda run: run.population,
        "seed": lambda run: run.seed,
        "reduction": lambda run: run.reduction,
        "state": lambda run: run.state,
        "best": lambda run: objective_number(run.simulated_best),
        "believed": lambda run: objective_number(run.best),
        "rating": lambda run: fixed(run.rating, 3),
        "sets": lambda run: run.alternatives,
        "mean": lambda run: fixed(run.mean, 3),
        "simulations": lambda run: run.simulations,
        "confirming": lambda run: run.confirmations,
        "analysis": lambda run: run.analysis,
        "converged": lambda run: run.converged_at,
        "after": lambda run: run.simulations_to_converge,
        "run": lambda run: run.run[:8],
    }
    shown = {name: value_of for name, value_of in columns.items() if not left_out.get(name)}
    caption = (
        "All runs; each is a campaign of its own, by whose id all of it can be read. Rating: of the best set, and sets: with the best "
        "objective, as the search believed; mean: of the last "
        "population; confirming: simulations of the best set after the search, among all; converged: in which iteration, after how many "
        "simulations"
    )
    return table(list(shown), [[value_of(run) for value_of in shown.values()] for run in runs], caption)
