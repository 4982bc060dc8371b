"""Reasons to doubt a best set: better sets that later simulations, or the campaign that is rerun, have shown. Pure."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from drivecal.analysis.chosen import Chosen
from drivecal.analysis.goals import EQUAL
from drivecal.contracts.assignments import value_text
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.results import Reason
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.scales import objective_text

SHORT = 8
"""Characters of a campaign's id in a sentence."""


@dataclass(frozen=True, slots=True)
class Later:
    """The first set of the ranking since other campaigns, by their ids, simulated cells that the search copied or predicted. `gain`: by how
    much it is better than the best set with which the search ended; below 0 if that proved to be worse."""

    objective: float
    gain: float
    parameters: Mapping[str, float | str]
    campaigns: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Earlier:
    """The best set of the `campaign` that is rerun, by its id, under the `weights` of the rerun, which are not normalised.

    `reused`: scenarios whose score is a reference's. `score`: the rerun's, as rankings name it, if the earlier campaign had another.
    `is_pruned`: only the sets that a pruning kept are compared; `objective` is None if that is none.
    """

    campaign: str
    objective: float | None
    weights: Mapping[str, float]
    reused: Sequence[str] = ()
    score: str | None = None
    is_pruned: bool = False


def sign_of(campaign: Campaign) -> int:
    """Returns 1 if more of the first objective is better, else -1."""
    if campaign.objective is None:
        return campaign.scale.sign
    return -1 if campaign.objective.direction == "minimise" else 1


def of_later(campaign: Campaign, later: Later | None, chosen: Chosen | None) -> Iterator[Reason]:
    """Yields the reason that later simulations changed which set is best."""
    if later is None or campaign.best is None or abs(later.gain) <= EQUAL:
        return
    by = f" (campaign {', '.join(each[:SHORT] for each in later.campaigns)})" if later.campaigns else ""
    values = f"{objective_text(later.objective)} beside {objective_text(campaign.best.objective)} at the end of the search"
    if later.gain < 0:
        text = f"Later simulations{by} show that the best set is worse, and the first set has {values}"
    elif chosen is not None and chosen.parameters == later.parameters:
        text = f"Later simulations{by} show that the chosen set is the best: {values}"
    else:
        text = f"Later simulations{by} show a better set: {values}"
    yield Reason(light="amber", about="later", text=f"{text}; `drivecal solutions {campaign.id[:SHORT]}` lists it.")


def of_earlier(campaign: Campaign, earlier: Earlier | None) -> Iterator[Reason]:
    """Yields the reason that the campaign which is rerun holds a better set, or may have held it before it was pruned."""
    if earlier is None or campaign.best is None or not CampaignState(campaign.state).ended:
        return
    if earlier.objective is None or (earlier.objective - campaign.best.objective) * sign_of(campaign) <= EQUAL:
        if earlier.is_pruned:
            text = f"The earlier campaign {earlier.campaign[:SHORT]} was pruned: it may have held a better set."
            yield Reason(light="amber", about="earlier", text=text)
        return
    copied = f" (a reference's score in {', '.join(earlier.reused)})" if earlier.reused else ""
    if campaign.objective is not None:
        text = (
            f"The earlier campaign {earlier.campaign[:SHORT]} holds a set with a better {campaign.objective.name}: "
            f"{earlier.objective:.6g}{copied} beside {campaign.best.objective:.6g}; `drivecal front {campaign.id[:SHORT]} --everything` "
            "lists what is stored, and a campaign file with it in `optimizer.start_sets` searches from there."
        )
        yield Reason(light="amber", about="earlier", text=text)
        return
    weights = ",".join(f"{name}={value_text(weight, None)}" for name, weight in earlier.weights.items())
    score = "" if earlier.score is None else f" --score {earlier.score}"
    values = f"{objective_text(earlier.objective)}{copied} beside {objective_text(campaign.best.objective)}"
    text = (
        f"The earlier campaign holds a better set under {'these weights' if earlier.score is None else 'this score'}: {values}; "
        f"`drivecal solutions {earlier.campaign[:SHORT]} --weights {weights}{score}` lists it, and the same rerun with --from-best "
        "searches from there."
    )
    yield Reason(light="amber", about="earlier", text=text)
