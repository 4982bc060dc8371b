"""Confirmation of a search's best set, or of its front, by simulation if scores are references'. Pure.

A search that reuses scores prefers sets whose references are too good. So the first set of the ranking is simulated if it has a
reference's score, and the ranking is computed again. This repeats until the first set has only scores of its own. Predictions may also be
too bad: sets that were dismissed on a prediction alone get a last look, if all answers together say that they may be better.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from drivecal.analysis.solutions import EvaluatedSet, FrontMember, Ranking
from drivecal.contracts.campaign import Confirmation
from drivecal.domain.rounding import same


@dataclass(slots=True)
class Confirming:
    """Confirmation of a search: at most `limit` sets are `tried`, once each, by id; `believed` is the search's best objective,
    `last_look` has the ids of dismissed sets to try as well."""

    limit: int
    believed: float
    tried: list[int] = field(default_factory=list)
    last_look: Sequence[int] = ()

    def choose(self, ranking: Ranking) -> EvaluatedSet | None:
        """Returns the next set to simulate; None if the first of the ranking has only scores of its own and the last look is over, or
        nothing more may be tried."""
        if len(self.tried) >= self.limit:
            return None
        seconds = (ranking.predicted(number) for number in self.last_look if number not in self.tried)
        return ranking.doubtful(self.tried) or next(filter(None, seconds), None)

    def is_changed(self, best: EvaluatedSet) -> bool:
        """Returns whether the first of the final ranking is another set than the search believed, or has another objective."""
        is_other = best.parameter_set != self.tried[0] and self.tried[0] not in self.last_look
        return is_other or not same(best.objective, self.believed, best.span)

    def outcome(self, best: EvaluatedSet, untried: EvaluatedSet | None = None) -> Confirmation:
        """Returns the outcome.

        Args:
            best: the first set of the final ranking.
            untried: a set that is believed to be better.
        """
        better = untried is not None and _is_better(untried, best)
        return Confirmation(
            state="unconfirmed" if best.reused else "untried" if better else "confirmed",
            tried=len(self.tried),
            objective=best.objective,
            believed=self.believed,
            reach=untried.objective if untried is not None and better else None,
            copied=list(best.reused),
            failed=bool(best.reused) and best.parameter_set in self.tried,
        )


def front_outcome(front: Sequence[FrontMember], tried: Sequence[int], untried: EvaluatedSet | None = None) -> Confirmation:
    """Returns the outcome for the sets of a front.

    Args:
        front: the final front.
        tried: the simulated sets, by id.
        untried: a set that is believed to be on the front.
    """
    copied = sum(bool(member.solution.reused) for member in front)
    state = "unconfirmed" if copied else "confirmed" if untried is None else "untried"
    return Confirmation(state=state, tried=len(tried), front=len(front), front_copied=copied)


def _is_better(believed: EvaluatedSet, best: EvaluatedSet) -> bool:
    """Returns whether a set is believed to be better than the best one by more than its rating."""
    if not same(believed.violation, best.violation):
        return believed.violation < best.violation
    return not believed.equals(best) and best.sign * (believed.objective - best.objective) > 0
