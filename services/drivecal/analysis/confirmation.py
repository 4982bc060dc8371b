"""Confirmation of a search's best set, or of its front, by simulation if scores are references'. Pure.

A search that reuses scores prefers sets whose references are too good. So the first set of the ranking is simulated if it has a
reference's score, and the ranking is computed again. This repeats until the first set has only scores of its own.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from drivecal.analysis.goals import EQUAL
from drivecal.analysis.solutions import EvaluatedSet, FrontMember, Ranking
from drivecal.domain.scales import objective_text

CONFIRMED = "confirmed by simulation"
"""Beginning of the verdict if the best set has only scores of its own."""
NOT_CONFIRMED = "not confirmed"
"""Beginning of the verdict if a score of the best set is still a reference's."""
UNTRIED = "better sets may exist"
"""Beginning of the verdict if the best set is simulated, but not all that are believed to be better."""


@dataclass(slots=True)
class Confirmation:
    """Confirmation of a search: at most `limit` sets are `tried`, once each, by id; `believed` is the search's best objective."""

    limit: int
    believed: float
    tried: list[int] = field(default_factory=list)

    def choose(self, ranking: Ranking) -> EvaluatedSet | None:
        """The next set to simulate; None if the first of the ranking has only scores of its own, or nothing more may be tried."""
        return None if len(self.tried) >= self.limit else ranking.doubtful(self.tried)

    def changed(self, best: EvaluatedSet) -> bool:
        """Whether the first of the final ranking is another set than the search believed, or another objective."""
        return best.parameter_set != self.tried[0] or abs(best.objective - self.believed) > EQUAL

    def verdict(self, best: EvaluatedSet, untried: EvaluatedSet | None = None) -> str:
        """Returns the verdict as a sentence, from the first set of the final ranking and a set that is believed to be better."""
        sets = "1 set" if len(self.tried) == 1 else f"{len(self.tried)} sets"
        if not best.reused and untried is not None and _is_better(untried, best):
            reach = f"others are believed to reach {objective_text(untried.objective)}"
            believed = f"the best simulated objective is {objective_text(best.objective)}, {reach}"
            return f"{UNTRIED}: {believed}; no more than {sets} (reduction.confirm) were tried"
        if not best.reused:
            equal = abs(best.objective - self.believed) <= EQUAL
            believed = "as the search believed" if equal else f"the search believed {objective_text(self.believed)}"
            return f"{CONFIRMED}: the best objective is {objective_text(best.objective)}, {believed}; {sets} tried"
        where = ", ".join(best.reused)
        owed = f"{NOT_CONFIRMED}: the best set's score in {where} is still a reference's"
        if best.parameter_set in self.tried:
            return f"{owed}, for its simulation failed; {sets} tried"
        return f"{owed}; no more than {sets} (reduction.confirm) were tried"


def front_verdict(front: Sequence[FrontMember], tried: Sequence[int], untried: EvaluatedSet | None = None) -> str:
    """Returns the verdict on the sets of a front as a sentence. `untried`: a set that is believed to be on the front."""
    sets = "1 set" if len(tried) == 1 else f"{len(tried)} sets"
    copied = sum(bool(member.solution.reused) for member in front)
    if not copied and untried is not None:
        return f"{UNTRIED}: others are believed to be on the front; no more than {sets} (reduction.confirm) were tried"
    if not copied:
        return f"{CONFIRMED}: the {len(front)} sets of the front have only scores of their own; {sets} tried"
    return f"{NOT_CONFIRMED}: {copied} of the {len(front)} sets of the front have references' scores; {sets} (reduction.confirm) tried"


def _is_better(believed: EvaluatedSet, best: EvaluatedSet) -> bool:
    """Returns whether a set is believed to be better than the best one by more than its rating."""
    gain = best.sign * (believed.objective - best.objective)
    return believed.violation < best.violation or (believed.violation == best.violation and gain > EQUAL)


def verdict_in(notes: Iterable[str]) -> str | None:
    """The verdict among a campaign's notes; None before it is reported."""
    return next((note for note in notes if note.startswith((CONFIRMED, NOT_CONFIRMED, UNTRIED))), None)


def remarkable(notes: Iterable[str]) -> list[str]:
    """A campaign's notes without the verdict that all is as it should be."""
    return [note for note in notes if not note.startswith(CONFIRMED)]
