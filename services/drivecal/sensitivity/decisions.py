"""The analysis that decided whether a parameter matters in a scenario, in words: intervals, confirmation, global analysis."""

from dataclasses import dataclass
from math import isnan

from drivecal.contracts.tables import DecidedBy
from drivecal.sensitivity.scenario import ParameterInfluence
from drivecal.sensitivity.thresholds import MuSigmaThresholds, Verdict


@dataclass(frozen=True, slots=True)
class Decision:
    """The deciding analysis, and its figures against the threshold in a sentence."""

    by: DecidedBy
    reason: str


def decision(result: ParameterInfluence, *, unknown: bool) -> Decision:
    """Returns what decided about a parameter. `unknown`: no run of the scenario was better than a failed one."""
    if unknown:
        return Decision("unknown", "no run of the scenario was better than a failed one, so it counts as influential")
    strongest = _strongest(result.intervals)
    place, interval = f"interval {strongest + 1} of {len(result.intervals)}", result.intervals[strongest]
    whole, overall = _over_the_whole_range(result), result.overall
    if result.influence.influential:
        if interval.influential:
            return Decision("intervals", f"{place} {_reaches(interval)}")
        if whole is not None and whole.influential:
            return Decision("confirmation", f"no interval reaches the threshold, but the whole range {_reaches(whole)}")
        return Decision("global", f"no interval reaches the threshold, but the global analysis {_reaches(overall or interval)}")
    below = [] if whole is None else [f"the whole range {_misses(whole)}"]
    if not interval.influential:
        return Decision(
            "intervals",
            " and ".join([f"no interval reaches the threshold: {place}, the strongest, {_misses(interval)}", *below]),
        )
    below += [] if overall is None else [f"the global analysis {_misses(overall)}"]
    return Decision("global", f"{place} {_reaches(interval)}, but {' and '.join(below)}")


def _over_the_whole_range(result: ParameterInfluence) -> Verdict | None:
    """Returns the last analysis over the parameter's whole range; None without one."""
    return next((done.verdict for done in reversed(result.confirmations) if done.region.side == "whole"), None)


def _strongest(intervals: tuple[Verdict, ...]) -> int:
    """Returns the place of the interval with the largest s_rel, of the influential ones if there are any."""
    influential = [place for place, verdict in enumerate(intervals) if verdict.influential]
    measured = [place for place in influential if intervals[place].threshold is not None]
    candidates = measured or influential or list(range(len(intervals)))

    def strength(place: int) -> float:
        s_rel = intervals[place].measures.s_rel
        return -1.0 if isnan(s_rel) else s_rel

    return max(candidates, key=strength)


def _reaches(verdict: Verdict) -> str:
    if verdict.threshold is None:
        return "has fewer than two known effects, which counts as influential"
    return f"reaches the threshold: {_figures(verdict)}"


def _misses(verdict: Verdict) -> str:
    return f"stays below it: {_figures(verdict)}"


def _figures(verdict: Verdict) -> str:
    measures, threshold = verdict.measures, verdict.threshold
    if isinstance(threshold, MuSigmaThresholds):
        return f"|mu| {abs(measures.mu):.3g} (threshold {threshold.mu:.3g}), sigma {measures.sigma:.3g} (threshold {threshold.sigma:.3g})"
    return f"s_rel {measures.s_rel:.3g} (threshold {0.0 if threshold is None else threshold:.3g})"
