"""Trust in the result of a search: a light, and the reasons for it in words. Pure.

Red: there is no result, its scores are in doubt, or a limit of the reduction is broken. Amber: the best set has its scores, but the search
may have missed better ones, or something was not examined. Green: nothing that is known speaks against it. There is no light before the
end, unless it is red already, and none for a campaign without a search.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

from drivecal.analysis.better_sets import SHORT, Earlier, Later, of_earlier, of_later, sign_of
from drivecal.analysis.chosen import Chosen, at_ends, baseline_breaks_more, every_score_is_known, reasons_for
from drivecal.analysis.confirmation import CONFIRMED, UNTRIED, verdict_in
from drivecal.analysis.convergence import Course, improved_last, stood_still
from drivecal.analysis.goals import EQUAL
from drivecal.bundles.scoring import REMEDY
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.results import Light, Reason, TrustAnswer
from drivecal.contracts.specification import ReductionSpecification
from drivecal.contracts.tables import RobustnessRow, ValidationRow
from drivecal.domain.campaigns import CampaignState

FEW = 0.01
"""Share of cells without a result, or without a score, up to which a search is as good as one without them."""
LONG = 3
"""Iterations from which on a search had time to improve what its first one found."""
NEARLY = 80
"""Percentage of the sets on the grid from which on a search has seen nearly all of them."""
LARGEST_COUNT = 10**9
"""Sets on a grid up to which their number is written out."""
_ORDER = ("red", "amber", "neutral", "green")
_DEFAULT = ReductionSpecification()


@dataclass(frozen=True, slots=True)
class Validated:
    """A validation of the campaign's influence map, or of its predictions, by the `campaign` with this id."""

    campaign: str
    rows: Sequence[ValidationRow]


@dataclass(frozen=True, slots=True)
class Driven:
    """A robustness study of the campaign's best sets, by the `campaign` with this id."""

    campaign: str
    rows: Sequence[RobustnessRow]


@dataclass(frozen=True, slots=True)
class Search:
    """The course of an ended search. `course`: objective and rating of the best set so far, by finished iteration; empty with several
    objectives, which have no single course. `ranges`: lower and upper value of the searched parameters with an order. `grid`: number of
    all sets of the space, 0 if it is no grid; `requested`: number of those that the search asked for, an upper limit unless `is_exact`."""

    course: Course
    ranges: Mapping[str, tuple[float, float]]
    requested: int = 0
    grid: int = 0
    is_exact: bool = True


@dataclass(frozen=True, slots=True)
class Compromises:
    """The front of several objectives. `dominating`: sets that are better than the baseline in an objective and worse in none; None
    without an evaluated baseline. `copied`: sets with a score of a reference."""

    size: int
    dominating: int | None
    copied: int = 0


def trust(
    campaign: Campaign,
    validated: Sequence[Validated] = (),
    driven: Sequence[Driven] = (),
    earlier: Earlier | None = None,
    search: Search | None = None,
    front: Compromises | None = None,
    chosen: Chosen | None = None,
    later: Later | None = None,
    withdrawn: int = 0,
) -> TrustAnswer:
    """Returns the light of a campaign and its reasons, the gravest first. Studies: the newest first. `earlier`: of the campaign that it
    reruns, if both have the same problem. `front`: of several objectives, in the place of a best set. With a `chosen` set, the reasons
    about a set are about this one. `withdrawn`: answers of the search by certificates that a simulation contradicted later."""
    if campaign.kind != "calibration" or campaign.spec.get("optimizer", {}) is None:
        return TrustAnswer(light=None, reasons=[])
    reasons = [
        *_end(campaign),
        *_result(campaign, search, front, chosen),
        *of_later(campaign, later, chosen),
        *of_earlier(campaign, earlier),
        *_map(campaign, _newest(validated, of_predictions=False)),
        *_references(campaign),
        *_predictions(campaign, _newest(validated, of_predictions=True)),
        *_certificates(withdrawn),
        *_noise(campaign),
        *_failures(campaign),
        *_cut(campaign),
        *_robustness(driven),
    ]
    reasons.sort(key=lambda reason: _ORDER.index(reason.light))
    lights = [reason.light for reason in reasons if reason.light != "neutral"]
    ended, worst = CampaignState(campaign.state).ended, (lights or ["green"])[0] if reasons else None
    return TrustAnswer(light=worst if ended or worst == "red" else None, reasons=reasons)


def _end(campaign: Campaign) -> Iterator[Reason]:
    state = CampaignState(campaign.state)
    if state is CampaignState.FAILED:
        yield Reason(light="red", about="end", text=f"The campaign failed: {campaign.error or 'no reason is stored'}")
    elif state.ended and campaign.best is None:
        yield Reason(light="red", about="end", text="No parameter set has a score in every scenario.")
    elif state is CampaignState.CANCELLED:
        yield Reason(light="amber", about="end", text="The campaign was cancelled before its search was complete.")


def _result(campaign: Campaign, search: Search | None, front: Compromises | None, chosen: Chosen | None) -> Iterator[Reason]:
    """Yields the reasons about the chosen set, else about the front of several objectives, else about the best set."""
    if chosen is not None:
        if not chosen.is_judged and not CampaignState(campaign.state).ended:
            return  # its cells may still be answered
        if chosen.is_best and front is None:
            verdict = list(_confirmation(campaign))
            about_it = [
                reason for reason in reasons_for(chosen, _ranges(search)) if not verdict or reason.about != "confirmation"
            ]
            yield from (*verdict, *about_it)
        else:
            yield from reasons_for(chosen, _ranges(search))
        yield from _course(campaign, search)
    elif front is not None:
        yield from (*_constraints(campaign), *_front(campaign, front))
        yield from _seen(campaign, search)
    else:
        yield from (*_constraints(campaign), *_confirmation(campaign), *_baseline(campaign), *_course(campaign, search))
        if campaign.best is not None:
            yield from at_ends("the best set", campaign.best.parameters, _ranges(search))


def _ranges(search: Search | None) -> Mapping[str, tuple[float, float]]:
    return {} if search is None else search.ranges


def _front(campaign: Campaign, front: Compromises) -> Iterator[Reason]:
    if campaign.best is None or not front.size:
        return
    verdict = verdict_in(campaign.notes)
    if verdict is not None:
        yield from _confirmation(campaign)
    elif front.copied:
        text = f"{front.copied:,} of {front.size:,} sets of the front have a reference's score."
        yield Reason(light="amber", about="confirmation", text=text)
    else:
        yield every_score_is_known("the sets of the front")
    if campaign.baseline is not None and campaign.best.violation < campaign.baseline.violation:
        yield baseline_breaks_more("the sets of the front")
    elif front.dominating:
        text = f"{front.dominating:,} of {front.size:,} sets of the front are better than the baseline in an objective and worse in none."
        yield Reason(light="green", about="baseline", text=text)
    elif front.dominating is not None:
        text = "No set is better than the baseline in an objective and worse in none: each is worse in one, or equal."
        yield Reason(light="amber", about="baseline", text=text)


def _constraints(campaign: Campaign) -> Iterator[Reason]:
    if campaign.best is not None and campaign.best.violation > 0:
        text = f"No set keeps all constraints; the best set breaks them by {campaign.best.violation:.1%}."
        yield Reason(light="red", about="constraints", text=text)


def _confirmation(campaign: Campaign) -> Iterator[Reason]:
    if campaign.best is None:
        return
    verdict = verdict_in(campaign.notes)
    if verdict is not None:
        light: Light = "green" if verdict.startswith(CONFIRMED) else "amber" if verdict.startswith(UNTRIED) else "red"
        yield Reason(light=light, about="confirmation", text=f"{verdict[0].upper()}{verdict[1:]}.")
    elif campaign.cells.reused and _setting(campaign, "confirm") == 0:
        text = "The best set was not simulated again after the search (reduction.confirm is 0): a score may be a reference's."
        yield Reason(light="amber", about="confirmation", text=text)
    elif CampaignState(campaign.state) is CampaignState.SUCCEEDED or (
        not campaign.cells.reused and CampaignState(campaign.state).ended
    ):
        yield every_score_is_known("the best set")


def _baseline(campaign: Campaign) -> Iterator[Reason]:
    if campaign.best is None or campaign.baseline is None or campaign.baseline.objective is None:
        return
    gain = (campaign.best.objective - campaign.baseline.objective) * sign_of(campaign)
    if campaign.best.violation < campaign.baseline.violation:
        yield baseline_breaks_more("the best set")
    elif gain > EQUAL:
        within = campaign.objective is None and gain <= campaign.scale.tolerance
        tolerated = f", within the tolerance of {campaign.scale.amount(campaign.scale.tolerance)}" if within else ""
        text = f"The best set is better than the baseline, by {gain:.4g}{tolerated}."
        yield Reason(light="neutral" if within else "green", about="baseline", text=text)
    else:
        yield Reason(light="amber", about="baseline", text="No set is better than the baseline.")


def _course(campaign: Campaign, search: Search | None) -> Iterator[Reason]:
    if search is None or campaign.best is None or CampaignState(campaign.state) is not CampaignState.SUCCEEDED:
        return
    yield from _seen(campaign, search)
    if improved_last(search.course):
        text = f"The best set was improved in the last of {len(search.course)} iterations: more may improve it further."
        yield Reason(light="green", about="search", text=text)
    if 100 * search.requested >= NEARLY * search.grid > 0:  # whole numbers: a grid may have more sets than a float can hold
        return
    if len(search.course) >= LONG and stood_still(search.course, campaign.best.objective) and not _is_the_highest(campaign):
        text = (
            f"No iteration after the first found a better set ({len(search.course) - 1} tried). More iterations, wider ranges or another "
            "optimizer may find one."
        )
        yield Reason(light="amber", about="search", text=text)


def _seen(campaign: Campaign, search: Search | None) -> Iterator[Reason]:
    """Yields the share of the space that the search saw."""
    if search is None or not search.grid or campaign.best is None:
        return
    grid = f"{search.grid:,}" if search.grid < LARGEST_COUNT else f"about {Decimal(search.grid):.0e}".replace("e+", " · 10^")
    asked = f"{'' if search.is_exact else 'at most '}{search.requested:,}"
    text = f"The search asked for {asked} of the {grid} sets on the grid of its space, constraints aside."
    yield Reason(light="green", about="search", text=text)


def _is_the_highest(campaign: Campaign) -> bool:
    """Returns whether no score is better: scores in steps end at the range's end."""
    scale = campaign.scale
    if campaign.objective is not None or scale.step is None or campaign.best is None:
        return False
    return not scale.is_better(scale.upper if scale.sign > 0 else scale.lower, campaign.best.objective)


def _map(campaign: Campaign, rows: Sequence[tuple[str, ValidationRow]]) -> Iterator[Reason]:
    uses_map = _setting(campaign, "mode") in {"influence", "both"} or campaign.narrowed is not None
    compared = [(study, row) for study, row in rows if row.compared and row.error_rate is not None] if uses_map else []
    inspected = _is_inspected(campaign)
    limit = _setting(campaign, "max_error") if inspected else _DEFAULT.max_error
    then = (
        "Lots keep most wrong answers out; the search may still have missed better sets."
        if inspected
        else "Nothing inspected them."
    )
    wrong_in: dict[tuple[Light, str], dict[str, str]] = {}
    for study, row in compared:
        rate, lower = row.error_rate or 0.0, row.lower_95 or 0.0
        if rate > limit:
            light: Light = "red" if lower > limit and not inspected else "amber"
            wrong_in.setdefault((light, study), {})[row.scenario] = f"{rate:.1%}"
    for (light, study), rates in wrong_in.items():
        text = f"The influence map is wrong for {_listed(rates)} of the compared variants (validation {study[:SHORT]}). {then}"
        yield Reason(light=light, about="map", scenario=_only(rates), text=text)
    if compared and all((row.error_rate or 0.0) <= limit for _, row in compared):
        worst, variants = max(row.error_rate or 0.0 for _, row in compared), sum(row.compared for _, row in compared)
        wrong = f"at most {worst:.1%} of the variants in a scenario are" if worst else f"none of {variants:,} variants is"
        yield Reason(light="green", about="map", text=f"The influence map was validated: {wrong} wrong.")
    elif uses_map and not compared and campaign.cells.reused and not inspected:
        text = "The influence map answered cells without lots (max_error is 1), and was not validated."
        yield Reason(light="amber", about="map", text=text)


def _references(campaign: Campaign) -> Iterator[Reason]:
    """Audits and lots of answers by references."""
    inspected = _is_inspected(campaign)
    for scenario, rate in campaign.error_rate.items():
        share = rate.wrong / rate.audited if rate.audited else 0.0
        seen = f"{rate.wrong:,} of {rate.audited:,} audited answers in {scenario} were wrong"
        if rate.stopped:
            yield Reason(light="amber", about="references", scenario=scenario, text=f"Reuse was stopped: {seen}.")
        elif not inspected and rate.wrong:
            light: Light = "red" if share > _DEFAULT.max_error else "amber"
            yield Reason(light=light, about="references", scenario=scenario, text=f"{seen}, and no lots were inspected.")
    differing = {name: f"{rate.contradictions:,}" for name, rate in campaign.error_rate.items() if rate.contradictions}
    if differing:
        text = f"Groups of sets that the influence map calls equal, with different simulated scores: {_listed(differing)}."
        yield Reason(light="amber", about="references", scenario=_only(differing), text=text)
    yield from _lots("references", "reused answers", [(rate.lots, rate.rejected) for rate in campaign.error_rate.values()])


def _predictions(campaign: Campaign, rows: Sequence[tuple[str, ValidationRow]]) -> Iterator[Reason]:
    yield from _lots("predictions", "predicted answers", [(each.lots, each.rejected) for each in campaign.released.values()])
    for study, row in rows:
        if not row.bases or not row.released or not row.inspected or row.limit is None:
            continue
        share, lower = (row.beyond or 0) / row.bases, row.beyond_lower_95 or 0.0
        allowed = row.limit * row.inspected / row.released
        light: Light = "red" if lower > allowed else "amber" if share > allowed else "green"
        text = (
            f"{share:.1%} of the simulated predictions in {row.scenario} are wrong (validation {study[:SHORT]}); up to {allowed:.1%} of "
            f"the {row.released:,} released ones may be: {row.limit:.1%} of the {row.inspected:,} in lots."
        )
        yield Reason(light=light, about="predictions", scenario=row.scenario, text=text)


def _certificates(withdrawn: int) -> Iterator[Reason]:
    if withdrawn:
        answers = "1 answer of the search rests" if withdrawn == 1 else f"{withdrawn:,} answers of the search rest"
        text = f"{answers} on certificates of setups in which a simulation contradicted a certificate: they were withdrawn."
        yield Reason(light="amber", about="certificates", text=text)


def _listed(figures: Mapping[str, str]) -> str:
    """Returns figures with their scenarios: `3.3% in S1 and 7.5% in S2`."""
    *first, last = (f"{figure} in {scenario}" for scenario, figure in figures.items())
    return f"{', '.join(first)} and {last}" if first else last


def _only(figures: Mapping[str, str]) -> str | None:
    return next(iter(figures)) if len(figures) == 1 else None


def _lots(about: str, what: str, counts: Iterable[tuple[int, int]]) -> Iterator[Reason]:
    lots, rejected = (sum(column) for column in zip(*counts, strict=True)) if (counts := list(counts)) else (0, 0)
    if lots:
        them = (
            "lot had too many errors, and all its cells were"
            if rejected == 1
            else "lots had too many errors, and all their cells were"
        )
        then = f"{rejected:,} {them} simulated" if rejected else "all passed"
        yield Reason(light="green", about=about, text=f"A sample of each of {lots:,} lots of {what} was simulated: {then}.")


def _noise(campaign: Campaign) -> Iterator[Reason]:
    unrepeatable = sum(cells.unrepeatable for cells in campaign.stages.values())
    if unrepeatable:
        text = f"{unrepeatable:,} simulations gave another result than an earlier run of the same cell: scores have noise."
        yield Reason(light="amber", about="noise", text=text)


def _failures(campaign: Campaign) -> Iterator[Reason]:
    cells = campaign.cells
    for count, what in ((cells.failed, "have no result"), (cells.unscored, "have no score, because its formula has no value")):
        if count:
            share = count / max(1, cells.requested)
            light: Light = "amber" if share > FEW else "green"
            text = f"{count:,} of {cells.requested:,} requested cells {what} ({share:.1%})."
            yield Reason(light=light, about="failures", text=text)


def _cut(campaign: Campaign) -> Iterator[Reason]:
    """Scores that were cut off at the worth of a failed run."""
    cut, requested = (sum(getattr(cells, name) for cells in campaign.stages.values()) for name in ("cut", "requested"))
    if not cut:
        return
    best, failed = {} if campaign.best is None else campaign.best.scores, campaign.scale.failed
    share, at_end = cut / max(1, requested), [name for name, score in best.items() if score == failed]
    light: Light = "amber" if at_end or share > FEW else "green"
    where = f", as the best set does in {', '.join(at_end)}" if at_end else ""
    scores, are, count = ("score", "is", "counts") if cut == 1 else ("scores", "are", "count")
    text = f"{cut:,} {scores} ({share:.1%} of the cells) {are} worse than {failed:g} and {count} as it{where}: {REMEDY}."
    yield Reason(light=light, about="cut", text=text)


def _robustness(driven: Sequence[Driven]) -> Iterator[Reason]:
    recommended = next((row for study in driven for row in study.rows if row.recommended), None)
    if recommended is None:
        return
    more = "at least " if recommended.at_least else ""
    kept = f"the vehicles of the study that differ by up to {more}{recommended.radius:.1%} of the ranges"
    if recommended.degree:
        text = f"The recommended set keeps its scores, within the study's limit, in {kept}."
        yield Reason(light="green", about="robustness", text=text)
    else:
        so_far = f" (it holds in {kept})" if recommended.radius else ""
        text = f"The recommended set breaks the study's limit in its first box of vehicles{so_far}."
        yield Reason(light="amber", about="robustness", text=text)


def _newest(validated: Iterable[Validated], *, of_predictions: bool) -> list[tuple[str, ValidationRow]]:
    """Returns the newest row of each scenario, with its campaign."""
    rows: dict[str, tuple[str, ValidationRow]] = {}
    for study in validated:
        for row in study.rows:
            if (row.released is not None) is of_predictions:
                rows.setdefault(row.scenario, (study.campaign, row))
    return list(rows.values())


def _is_inspected(campaign: Campaign) -> bool:
    """Returns whether answers by references are inspected in lots; earlier releases had a limit without lots."""
    lots = sum(rate.lots for rate in campaign.error_rate.values())
    return bool(_setting(campaign, "max_error") < 1) and (lots > 0 or not campaign.cells.reused)


def _setting(campaign: Campaign, name: str) -> Any:
    given = campaign.spec.get("reduction") or {}
    return given.get(name, getattr(_DEFAULT, name))
