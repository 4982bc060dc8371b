"""Trust in the result of a search: verdicts, and the answers to the questions that they are about. Pure.

A light says what a finding means for an engineer. Scores: red if they are in doubt, or a limit of the reduction is broken; amber if
something was not examined. Search: amber if more simulations, wider ranges or another optimizer may find better sets; green if it
converged, or saw nearly everything. There are no lights before the end, but red ones, and none for a campaign without a search.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from math import inf
from statistics import median
from typing import Any, Literal

from drivecal.analysis.convergence import (
    UNCHANGED_ALTERNATIVES,
    UNCHANGED_BEST,
    Course,
    alternatives_at,
    best_at,
    changes,
    expected_gain,
    improved_last,
    last_change,
    stood_still,
)
from drivecal.analysis.verdicts import answers, confirmation_verdict, verdict
from drivecal.contracts.campaign import Best, Campaign, ErrorRate, Released
from drivecal.contracts.results import Light, ResultTrust, ResultVerdict, StudyResult
from drivecal.contracts.specification import ConstraintSpecification, ReductionSpecification
from drivecal.contracts.tables import ValidationRow
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.rounding import grain

FEW = 0.1
"""Largest share of cells without a result or a score of their own that is no doubt: runs of the judged sets have other verdicts."""
LONG = 3
"""Least number of iterations that gives a search time to improve its first result."""
NEARLY = 80
"""Least percentage of a grid's sets that counts as nearly all."""
LARGEST_COUNT = 10**9
"""Largest number of a grid's sets that is written out."""
LITTLE = 0.01
"""Largest gain of twice the budget that is no reason to go on, as a share of the gain of the whole search over its first set, and over the
usual set of its first half."""
AT_END = 0.005
"""Largest distance of a value at the end of its range, as a share of the range."""
LEAST_RECORDED, MOST_STORED = 150, 0.1
"""Least simulations, and largest share of stored answers, of a search for which the record holds."""
RECORD = 0.90
"""Share of correct estimates: a search with twice the cells, which began with the answers, gained no more than expected. 65 of 72, after
150 and 300 cells (`economy --outlook --problems acc_curve monotone_curve cliff funnel few_matter braking --seeds 6 --cells 600`)."""
_ORDER = ("red", "amber", "neutral", "green")
_DEFAULT = ReductionSpecification()


@dataclass(frozen=True, slots=True)
class BesideBaseline:
    """A set's and the baseline's value of an objective. `sign` is -1 if less is better. Differences within `tolerance` do not count."""

    name: str
    value: float
    baseline: float
    sign: int
    unit: str = "1"
    tolerance: float = 0.0

    @property
    def gain(self) -> float:
        """Improvement over the baseline's value; below 0 if the set's value is worse."""
        return self.sign * (self.value - self.baseline)

    @property
    def is_alike(self) -> bool:
        """True if the difference does not count."""
        return abs(self.gain) <= max(grain(self.value, self.baseline), self.tolerance)


@dataclass(frozen=True, slots=True)
class Chosen:
    """A set that was chosen, by its id. `compared` has the objectives that the baseline has as well. `copied` has the scenarios with a
    reference's score, and `failed` the scenarios, of `scenarios` in all, where each of its runs failed. Violations are shares. `is_judged`:
    every objective and constraint has a value. `bounded`: as of `Evidence`. `failures` and `failure_interval` as in `Best`."""

    parameters: Mapping[str, float | str]
    compared: Sequence[BesideBaseline] = ()
    copied: Sequence[str] = ()
    violation: float = 0.0
    undecided: bool = False
    baseline_violation: float = 0.0
    is_judged: bool = True
    failed: Sequence[str] = ()
    scenarios: int = 1
    bounded: Sequence[str] = ()
    failures: int = 0
    failure_interval: tuple[float, float] | None = None
    parameter_set: int = 0


@dataclass(frozen=True, slots=True)
class SearchCourse:
    """The course of an ended search. `course` has a point for each finished iteration, and is empty with several objectives. `ranges` has
    the lower and upper value of each searched parameter with an order, and `titles` curve and place of coefficients. `limits` has for both
    ends of a range the entry of the manifest that keeps a campaign within it: "" for none, None if nothing can be wider. `grid` is the
    number of sets of the space, 0 if it is no grid. The search requested `requested` of them, or fewer unless `is_exact`. The sets of the
    best objective lie in `regions` of the space, if there are several."""

    course: Course
    ranges: Mapping[str, tuple[float, float]]
    requested: int = 0
    grid: int = 0
    is_exact: bool = True
    regions: int | None = None
    titles: Mapping[str, str] = field(default_factory=dict)
    limits: Mapping[str, tuple[str | None, str | None]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Compromises:
    """The front of several objectives. `dominating`: sets that are better than the baseline in an objective and worse in none, None without
    an evaluated one. `is_close`: runs do not tell the baseline from them. `copied`: sets with a score of a reference. `late`: sets that the
    second half of the rounds found. `failing`: sets with nothing but failed runs in a scenario, one of `failed`."""

    size: int
    dominating: int | None
    is_close: bool = False
    copied: int = 0
    late: int = 0
    failing: int = 0
    failed: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Evidence:
    """Facts about a campaign's result that are not in its own record. `studies` has the newest first. With several objectives, `front`
    replaces the best set. A `chosen` set, if given, is judged instead of the best. `bounded`: the constraints on results in words, with
    the amounts of the best set."""

    studies: Sequence[StudyResult] = ()
    search: SearchCourse | None = None
    front: Compromises | None = None
    chosen: Chosen | None = None
    bounded: Sequence[str] = ()
    at_worst: Sequence[str] = ()
    """Scores by scenario that count as a failed run's, though the runs of the judged sets did not fail."""
    has_failures: bool = False
    """Runs failed, of whichever set."""
    is_random: bool = False
    """The simulator is random."""
    has_unknown_noise: bool = False
    """The search has ended, its simulator is random, and too few sets ran under several seeds."""


def sign_of(campaign: Campaign) -> int:
    """Returns 1 if more of the first objective is better, else -1."""
    if campaign.objective is None:
        return campaign.scale.sign
    return -1 if campaign.objective.direction == "minimise" else 1


def trust(campaign: Campaign, known: Evidence | None = None) -> ResultTrust:
    """Returns the verdicts on a campaign, or on a chosen set, the gravest first, and the answers that they add up to."""
    if campaign.kind != "calibration" or campaign.spec.get("optimizer", {}) is None:
        return ResultTrust(answers=[], verdicts=[])
    known = known or Evidence()
    verdicts = [
        *_end(campaign),
        *_result(campaign, known),
        *_left_out(campaign),
        *_budget(campaign),
        *_map(campaign, _newest(known.studies, of_predictions=False)),
        *_references(campaign),
        *_predictions(campaign, _newest(known.studies, of_predictions=True)),
        *_noise(campaign),
        *_failures(campaign, known),
        *_robustness(campaign, known.studies),
    ]
    verdicts.sort(key=lambda each: _ORDER.index(each.light))
    return ResultTrust(answers=answers(verdicts, ended=CampaignState(campaign.state).ended), verdicts=verdicts)


def _end(campaign: Campaign) -> Iterator[ResultVerdict]:
    state = CampaignState(campaign.state)
    if state is CampaignState.FAILED:
        yield verdict("failed", "red", error=campaign.error or "no reason is stored")
    elif state.ended and campaign.best is None:
        yield verdict("no_result", "red")
    elif state is CampaignState.CANCELLED:
        yield verdict("cancelled", "amber")


def _result(campaign: Campaign, known: Evidence) -> Iterator[ResultVerdict]:
    """Yields the verdicts on the chosen set, else on the front of several objectives, else on the best set."""
    search, front, chosen = known.search, known.front, known.chosen
    if known.has_unknown_noise and campaign.best is not None:
        yield verdict("noise_unknown", "amber")
    if chosen is not None:
        if not chosen.is_judged and not CampaignState(campaign.state).ended:
            return  # its cells may still be answered
        yield from _chosen(campaign, chosen, known)
    elif front is not None:
        yield from (*_constraints(campaign, known), *_front(campaign, front))
    else:
        yield from (*_constraints(campaign, known), *_confirmation(campaign), *_baseline(campaign, known))
    yield from _course(campaign, search, is_random=known.is_random)
    if front is not None and front.size and campaign.ended_by not in {None, "cancelled", "failed"}:
        light: Light | Literal["neutral"] = "neutral" if known.is_random else "amber" if front.late else "green"
        code = "front_grew" if front.late else "front_stood"
        yield verdict(code, light, by=campaign.ended_by, late=front.late, size=front.size)
    if chosen is None and campaign.best is not None:
        yield from _at_ends(f"the best set{' by the first objective' if front else ''}", campaign.best, search)


def _chosen(campaign: Campaign, chosen: Chosen, known: Evidence) -> Iterator[ResultVerdict]:
    """Yields constraints, origin of the scores, baseline, and values at an end of their range."""
    if not chosen.is_judged:
        yield verdict("not_judged", "red")
        return
    yield from _constraints(campaign, known)
    yield from _failing("the chosen set", chosen.failed, chosen.scenarios)
    if chosen.copied:
        yield verdict("scores_copied", "amber", scenarios=list(chosen.copied))
    else:
        yield verdict("scores_simulated", "green", subject="the chosen set")
    if chosen.violation < chosen.baseline_violation and not chosen.undecided:
        yield verdict("baseline_breaks_more", "amber" if chosen.violation > 0 else "green", subject="the chosen set")
    elif chosen.compared:
        counted = [each.gain for each in chosen.compared if not each.is_alike]
        light: Light | Literal["neutral"] = "amber"
        if known.is_random:
            light = "neutral"  # means of different seeds tell too little
        elif counted:
            light = "green" if min(counted) > 0 else "amber"
        elif any(each.gain > grain(each.value, each.baseline) for each in chosen.compared):
            light = "neutral"
        fields = ("name", "value", "baseline", "unit", "gain", "tolerance")
        objectives = [{name: getattr(each, name) for name in fields} for each in chosen.compared]
        yield verdict("beside_baseline", light, objectives=objectives)
    yield from _at_ends("the chosen set", chosen, known.search)


def _at_ends(subject: str, judged: Best | Chosen, search: SearchCourse | None) -> Iterator[ResultVerdict]:
    at_end, entries = dict[str, float](), dict[str, None]()
    search = search or SearchCourse([], {})
    for name, ends in search.ranges.items():
        for end, entry in zip(ends, search.limits.get(name, ("", "")), strict=True):
            value = judged.parameters.get(name)
            if isinstance(value, float | int) and abs(value - end) <= AT_END * (ends[1] - ends[0]) and entry is not None:
                at_end[search.titles.get(name, name)] = value
                entries |= {entry: None} if entry else {}
    if at_end:
        light: Light | Literal["neutral"] = "neutral" if judged.failures else "amber"
        yield verdict("at_ends", light, subject=subject, values=at_end, entries=list(entries))


def _front(campaign: Campaign, front: Compromises) -> Iterator[ResultVerdict]:
    if campaign.best is None or not front.size:
        return
    yield from _failing(f"{front.failing:,} of {front.size:,} sets of the front", front.failed)
    if campaign.confirmation is not None:
        yield confirmation_verdict(campaign.confirmation)
    elif front.copied:
        yield verdict("front_copied", "amber", copied=front.copied, size=front.size)
    else:
        yield verdict("scores_simulated", "green", subject="the sets of the front")
    best, before = campaign.best, campaign.baseline
    if before is not None and not (before.undecided or best.undecided) and best.violation < before.violation:
        yield verdict("baseline_breaks_more", "amber" if best.violation > 0 else "green", subject="the sets of the front")
    elif front.dominating and front.is_close:
        yield verdict("front_close_to_baseline", "neutral", dominating=front.dominating, size=front.size)
    elif front.dominating:
        yield verdict("front_beats_baseline", "green", dominating=front.dominating, size=front.size)
    elif front.dominating is not None:
        yield verdict("front_not_better", "amber")


def _left_out(campaign: Campaign) -> Iterator[ResultVerdict]:
    """Yields the scenarios of weight 0 that a constraint on all scenarios leaves out."""
    left_out = [name for name, weight in (campaign.spec.get("weights") or {}).items() if weight == 0]
    of_all = (each for each in campaign.spec.get("constraints") or () if each.get("scenarios", "all") == "all")
    if left_out and any(not each.get("changes") and not each.get("distance") for each in of_all):
        yield verdict("constraints_left_out", "neutral", scenarios=left_out)


def _lights(campaign: Campaign, *, is_random: bool) -> tuple[Light | Literal["neutral"], Light]:
    """Returns the lights of constraints that are kept and broken. A mean over seeds is uncertain, which only rates count in."""
    constraints = campaign.spec.get("constraints") or ()
    exact = sum(any(map(each.get, ("rate", "changes", "distance"))) for each in constraints)
    if not is_random or exact == len(constraints):
        return "green", "red"
    return "neutral", "red" if exact else "amber"  # an exact one may be broken


def _constraints(campaign: Campaign, known: Evidence) -> Iterator[ResultVerdict]:
    """Yields whether the chosen set, else the best one, keeps its constraints."""
    judged, subject = known.chosen or campaign.best, "the best set" if known.chosen is None else "the chosen set"
    if judged is None:
        return
    bounded = list((known.chosen or known).bounded)
    kept, broken = _lights(campaign, is_random=known.is_random)
    if judged.undecided:
        yield verdict("constraints_undecided", "amber", subject=subject, bounded=bounded)
    elif judged.violation > 0 and isinstance(judged, Best) and judged.replicates == 1:
        yield verdict("no_set_keeps_constraints", broken, share=judged.violation, bounded=bounded)
    elif judged.violation > 0:  # of sets with fewer runs, these may look as if they kept them
        broke = f"By its runs, {subject}" if known.chosen is None else subject.capitalize()
        yield verdict("constraints_broken", broken, subject=broke, share=judged.violation, bounded=bounded)
    elif bounded:
        by = " by the first objective" if known.front is not None and known.chosen is None else ""
        yield verdict("constraints_kept", kept, subject=subject.capitalize() + by, bounded=bounded)


def _failing(subject: str, failed: Sequence[str], scenarios: int = 0) -> Iterator[ResultVerdict]:
    if failed:
        yield verdict("fails", "red" if len(failed) == scenarios else "amber", subject=subject, scenarios=list(failed))


def _confirmation(campaign: Campaign) -> Iterator[ResultVerdict]:
    state = CampaignState(campaign.state)
    if campaign.best is None:
        return
    yield from _failing("the best set", campaign.best.failed, len(campaign.best.scores))
    if campaign.confirmation is not None:
        yield confirmation_verdict(campaign.confirmation)
    elif campaign.cells.reused and _setting(campaign, "confirm") == 0:
        yield verdict("never_confirmed", "amber")
    elif state is CampaignState.SUCCEEDED or (not campaign.cells.reused and state.ended):
        yield verdict("scores_simulated", "green", subject="the best set")


def _baseline(campaign: Campaign, known: Evidence) -> Iterator[ResultVerdict]:
    if campaign.best is None or campaign.baseline is None:
        return
    if campaign.baseline.objective is None:
        if CampaignState(campaign.state).ended:
            yield verdict("baseline_without_result", "amber")
        return
    failed, scores = campaign.scale.failed, campaign.best.scores
    failing = [name for name, score in campaign.baseline.scores.items() if score == failed != scores.get(name)]
    if failing and campaign.objective is None:
        yield verdict("baseline_fails", "neutral", scenarios=failing, failed=failed)
    gain, under = campaign.baseline.gain, " under the seeds that report both"
    if gain is None:
        under = ""
        gain = (campaign.best.objective - campaign.baseline.objective) * sign_of(campaign)
    undecided = campaign.baseline.undecided or campaign.best.undecided
    least = grain(campaign.best.objective, campaign.baseline.objective)
    fewest, most = campaign.best.failure_interval or (0.0, 0.0)
    is_mean = campaign.baseline.gain is not None and campaign.objective is None  # of a quantile few failures may cost nothing
    unseen = most if known.has_failures and fewest == 0 and is_mean else 0.0
    if campaign.best.violation < campaign.baseline.violation and not undecided:
        yield verdict("baseline_breaks_more", "amber" if campaign.best.violation > 0 else "green", subject="the best set")
    elif campaign.baseline.close:
        gained = f": a {'gain' if gain > 0 else 'loss'} of {abs(gain):.4g}{under}" if under else ""
        yield verdict("baseline_in_interval", "neutral", gained=gained)
    elif under and -gain > least:
        yield verdict("worse_than_baseline", "amber", loss=-gain, under=under)
    elif gain <= least:
        yield verdict("not_better", "amber")
    elif campaign.objective is None and gain <= campaign.scale.tolerance:
        tolerance = campaign.scale.amount(campaign.scale.tolerance)
        yield verdict("alike_baseline", "neutral", gain=gain, under=under, tolerance=tolerance)
    elif gain <= unseen * abs(failed - campaign.best.objective):
        yield verdict("failures_may_decide", "neutral", gain=gain, under=under, most=most, failed=failed)
    else:
        yield verdict("better_than_baseline", "neutral" if campaign.best.undecided else "green", gain=gain, under=under)


def _course(campaign: Campaign, search: SearchCourse | None, *, is_random: bool) -> Iterator[ResultVerdict]:
    if search is None or campaign.best is None:
        return
    yield from _seen(campaign, search)
    if search.regions is not None:
        yield verdict("optima", "neutral", sets=campaign.best.alternatives, regions=search.regions)
    yield from _convergence(search.course) if campaign.budget is None else _ended(campaign, search.course, is_random=is_random)
    if CampaignState(campaign.state) is not CampaignState.SUCCEEDED:
        return
    if improved_last(search.course) and not _has_outlook(campaign):
        yield verdict("still_rising", "amber", iterations=len(search.course))
    if _saw_nearly_all(search):
        return
    if len(search.course) >= LONG and stood_still(search.course, campaign.best.objective) and not _is_the_highest(campaign):
        yield verdict("stood_still", "amber", tried=len(search.course) - 1)


def _saw_nearly_all(search: SearchCourse) -> bool:
    return 100 * search.requested >= NEARLY * search.grid > 0  # whole numbers: a grid may have more sets than a float can hold


def _has_outlook(campaign: Campaign) -> bool:
    """Returns whether it is known how well searches of its kind foretell what more simulations would bring."""
    return campaign.budget is not None and (campaign.spec.get("optimizer") or {}).get("kind") == "surrogate"


def _budget(campaign: Campaign) -> Iterator[ResultVerdict]:
    """Yields how much of the budget is used."""
    stored = campaign.cells.repeated if _has_outlook(campaign) else 0  # a search by the cell counts them
    taken = f", {campaign.spent.stored:,} of them from the table" if campaign.spent.stored else ""
    by = {"simulations": f" and {stored:,} stored answers" if stored else taken}
    used = [
        f"{round(spent, 1 if limit >= 1 else 2):,} of {limit:,.12g} {unit}{by.get(unit, '')}"
        for unit, spent in (("simulations", campaign.spent.simulations), ("minutes", campaign.spent.minutes))
        if (limit := (campaign.budget or {}).get(unit)) is not None
    ]
    if used:
        yield verdict("budget", "neutral", used=", ".join(used))


def _ended(campaign: Campaign, course: Course, *, is_random: bool) -> Iterator[ResultVerdict]:
    """Yields what ended a search with a budget. Its rounds are no generations: the paper's criteria say nothing. Luck foretells nothing."""
    if campaign.ended_by not in {None, "cancelled"} and course:
        best = [each.best for each in course]
        share = last_change(best) / len(course)
        stood = campaign.ended_by == "stagnation" and bool((campaign.budget or {}).get("stagnation"))  # as chosen
        yield verdict("ended", "green" if stood else "neutral", by=campaign.ended_by, share=share)
        if is_random or not _has_outlook(campaign) or (gain := expected_gain(best)) is None:
            return
        light: Light | Literal["neutral"] = "neutral" if stood else "amber"
        simulated, stored, requested = campaign.spent.simulations, campaign.cells.repeated, campaign.cells.requested
        if simulated < LEAST_RECORDED:
            yield verdict("no_outlook", light, simulations=simulated, least=LEAST_RECORDED)
            return
        if stored > MOST_STORED * requested:
            yield verdict("no_outlook_stored", light, stored=stored, requested=requested)
            return
        known = [value for value in best if value is not None]
        # a step is a gain: the tolerance of a score with steps is for copied scores
        tolerance = 0.0 if campaign.objective or campaign.scale.step is not None else campaign.scale.tolerance
        usual = [each.mean for each in course[: -(-len(course) // 2)] if each.mean is not None]
        # the first set may have failed, or break constraints: better than that is soon found
        whole = min(abs(known[-1] - known[0]), abs(known[-1] - median(usual)) if usual else inf)
        if not stood and gain <= max(tolerance, LITTLE * whole) and whole > 0:
            light = "green"
        yield verdict("outlook", light, gain=gain, record=RECORD) if gain or whole else verdict("no_outlook_still", light)


def _convergence(course: Course) -> Iterator[ResultVerdict]:
    """Yields a verdict for each criterion of Tables 5 and 7 of the paper."""
    best, alternatives = [each.best for each in course], [each.alternatives for each in course]
    if not best or best[-1] is None:
        return
    criteria = (
        ("best objective", best, best_at(best), UNCHANGED_BEST),
        (
            "number of alternative optima",
            changes(best, alternatives),
            alternatives_at(best, alternatives),
            UNCHANGED_ALTERNATIVES + 1,
        ),
    )
    for of, values, converged, unchanged in criteria:
        code = "not_converged" if converged is None else "converged"
        iteration = last_change(values) if converged is None else converged
        light: Light | Literal["neutral"] = "neutral" if values is not best else "amber" if converged is None else "green"
        yield verdict(code, light, of=of, iteration=iteration, iterations=len(course), unchanged=unchanged)


def _seen(campaign: Campaign, search: SearchCourse | None) -> Iterator[ResultVerdict]:
    """Yields the share of the space that the search saw."""
    if search is None or not search.grid or campaign.best is None:
        return
    grid = f"{search.grid:,}" if search.grid < LARGEST_COUNT else f"about {Decimal(search.grid):.0e}".replace("e+", " · 10^")
    asked = f"{'' if search.is_exact else 'at most '}{search.requested:,}"
    yield verdict("seen", "green" if _saw_nearly_all(search) else "neutral", asked=asked, grid=grid)


def _is_the_highest(campaign: Campaign) -> bool:
    """Returns whether no score is better: scores in steps end at the range's end."""
    scale = campaign.scale
    if campaign.objective is not None or scale.step is None or campaign.best is None:
        return False
    return not scale.is_better(scale.upper if scale.sign > 0 else scale.lower, campaign.best.objective)


def _map(campaign: Campaign, rows: Sequence[tuple[str, ValidationRow]]) -> Iterator[ResultVerdict]:
    uses_map = _setting(campaign, "mode") in {"influence", "both"}
    compared = [(study, row) for study, row in rows if row.compared and row.error_rate is not None] if uses_map else []
    used, inspected = campaign.cells.reused > 0, _setting(campaign, "max_error") < 1
    limit = _setting(campaign, "max_error") if inspected else _DEFAULT.max_error
    kept = "Lots keep most wrong answers out; the search may still have missed better sets."
    then = "It answered no cell." if not used else kept if inspected else "Nothing inspected them."
    wrong_in: dict[tuple[Light | Literal["neutral"], str], dict[str, float]] = {}
    for study, row in compared:
        rate, lower = row.error_rate or 0.0, row.lower_95 or 0.0
        if rate > limit:
            light: Light | Literal["neutral"] = "neutral" if not used else "red" if lower > limit and not inspected else "amber"
            wrong_in.setdefault((light, study), {})[row.scenario] = rate
    for (light, study), rates in wrong_in.items():
        yield verdict("map_wrong", light, _only(rates), rates=rates, study=study, then=then)
    if compared and not wrong_in:
        wrong, variants = (sum(getattr(row, name) for _, row in compared) for name in ("wrong", "compared"))
        worst = max(row.error_rate or 0.0 for _, row in compared)
        upper = max(1.0 if row.upper_95 is None else row.upper_95 for _, row in rows if row.reducible)
        validated: Light | Literal["neutral"] = "green" if upper <= limit else "neutral" if inspected else "amber"
        yield verdict("map_validated", validated, wrong=wrong, variants=variants, worst=worst, upper=upper)
    elif uses_map and not compared and campaign.cells.reused and not inspected:
        yield verdict("map_unchecked", "amber")


def _references(campaign: Campaign) -> Iterator[ResultVerdict]:
    """Yields verdicts on audits and lots of answers by references."""
    inspected = _setting(campaign, "max_error") < 1
    for scenario, rate in campaign.error_rate.items():
        light: Light = "red" if rate.wrong > _DEFAULT.max_error * rate.audited and not inspected else "amber"
        if rate.wrong and (not inspected or 2 * rate.rejected > rate.lots):
            then = ", though lots kept most out: correct the map or analyse again" if inspected else ", without any lots"
            yield verdict("audits_wrong", light, scenario, wrong=rate.wrong, audited=rate.audited, then=then)
    differing = {name: rate.contradictions for name, rate in campaign.error_rate.items() if rate.contradictions}
    if differing:
        yield verdict("contradictions", "amber" if campaign.cells.reused else "neutral", _only(differing), groups=differing)
    yield from _lots("reused", campaign.error_rate.values())


def _predictions(campaign: Campaign, rows: Sequence[tuple[str, ValidationRow]]) -> Iterator[ResultVerdict]:
    yield from _lots("predicted", campaign.released.values())
    for study, row in rows:
        if not row.bases or not row.released or not row.inspected or row.limit is None:
            continue
        share, lower = (row.beyond or 0) / row.bases, row.beyond_lower_95 or 0.0
        allowed = min(1.0, row.limit * row.inspected / row.released)
        light: Light = "red" if lower > allowed else "amber" if share > allowed else "green"
        numbers = {"released": row.released, "limit": row.limit, "inspected": row.inspected}
        yield verdict("predictions_validated", light, row.scenario, share=share, study=study, allowed=allowed, **numbers)


def _only(figures: Mapping[str, object]) -> str | None:
    return next(iter(figures)) if len(figures) == 1 else None


def _lots(kind: str, rates: Collection[ErrorRate | Released]) -> Iterator[ResultVerdict]:
    counts = {name: sum(getattr(rate, name) for rate in rates) for name in ("lots", "sampled", "inspected", "rejected")}
    if counts["lots"]:
        yield verdict("lots", "green", kind=kind, **counts)


def _noise(campaign: Campaign) -> Iterator[ResultVerdict]:
    if unrepeatable := sum(cells.unrepeatable for cells in campaign.stages.values()):
        yield verdict("noise", "amber", unrepeatable=unrepeatable)


def _failures(campaign: Campaign, known: Evidence) -> Iterator[ResultVerdict]:
    """Yields the verdicts on failed runs, cells without a result or a score, and scores cut off at the worth of a failed run."""
    judged = known.chosen or campaign.best
    if judged is not None and judged.failure_interval is not None:
        least, most = judged.failure_interval
        rates = map(ConstraintSpecification.model_validate, campaign.spec.get("constraints") or ())
        rate = min((each.rate or 0.0 for each in rates if each.counts_failures and each.scenarios == "all"), default=0.0)
        failing: Light | Literal["neutral"] = "amber" if judged.failures and least + most > 2 * rate else "neutral"
        light, subject = "red" if 0 < rate < least else failing, "the best set" if known.chosen is None else "the chosen set"
        yield verdict("failing_runs", light, subject=subject, failures=judged.failures, most=most)
    if known.at_worst:
        subject = "the chosen set" if known.chosen else "the best set" if known.front is None else "the front's sets"
        yield verdict("at_worst", "amber", subject=subject, values=list(known.at_worst))
    cut = [sum(getattr(cells, name) for cells in campaign.stages.values()) for name in ("cut", "requested")]
    cells = campaign.cells
    lost = ("without_result", cells.failed, cells.requested), ("without_score", cells.unscored, cells.requested)
    for code, count, requested in (*lost, ("cut", *cut)):
        if count:
            share = count / max(1, requested)
            yield verdict(code, "amber" if share > FEW else "neutral", count=count, requested=requested, share=share)


def _robustness(campaign: Campaign, studies: Sequence[StudyResult]) -> Iterator[ResultVerdict]:
    driven = (study for study in studies if study.study.in_own_vehicle)
    recommended = next((row for study in driven for row in study.robustness if row.recommended), None)
    if recommended is not None:
        is_bounded = campaign.best is not None and bool(campaign.best.constraints)
        goals = {"its constraints": is_bounded, "further objectives": len(campaign.spec.get("objectives") or ()) > 1}
        left_out = " and ".join(name for name, is_wanted in goals.items() if is_wanted)
        unseen = f"; {left_out} were not looked at there (`drivecal check --vehicle-parameters`)" if left_out else ""
        light: Light | Literal["neutral"] = "neutral" if unseen else "green"
        least = "at least " if recommended.at_least else ""
        most = recommended.failing_at_most
        failing = "" if most is None else f"; up to {100 * most:.1f} % of all such vehicles may still break it (95 %)"
        if recommended.degree:
            yield verdict("robust", light, least=least, radius=recommended.radius, failing=failing, unseen=unseen)
        else:
            yield verdict("not_robust", "amber", least=least, radius=recommended.radius)


def _newest(studies: Iterable[StudyResult], *, of_predictions: bool) -> list[tuple[str, ValidationRow]]:
    """Returns the newest row of each scenario, with its campaign."""
    rows: dict[str, tuple[str, ValidationRow]] = {}
    for study in studies:
        for row in study.validation:
            if (row.released is not None) is of_predictions:
                rows.setdefault(row.scenario, (study.study.campaign, row))
    return list(rows.values())


def _setting(campaign: Campaign, name: str) -> Any:
    given = campaign.spec.get("reduction") or {}
    return given.get(name, getattr(_DEFAULT, name))
