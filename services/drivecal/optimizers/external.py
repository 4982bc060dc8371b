"""`optimizer: {kind: external}`: another program proposes the sets, by the API, and a campaign evaluates them."""

from typing import Annotated, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field

from drivecal.plugins.ports import Ability


class ExternalSettings(BaseModel):
    """Evaluates the sets that another program proposes, until the budget is used up or that program finishes the campaign."""

    model_config = ConfigDict(extra="forbid")

    kind: Literal["external"] = "external"
    seed: Annotated[int, Field(ge=0, lt=2**63, description="Seed of the checks of reused answers.")] = 1
    infeasible: Annotated[
        Literal["refuse", "repair"],
        Field(description="Refuses sets outside of the bounds or constraints, or takes a near set that keeps them."),
    ] = "refuse"


class External:
    """An optimizer without a search: its rounds are the sets that another program proposes."""

    name = "external"
    settings: type[BaseModel] = ExternalSettings
    supports: frozenset[Ability] = frozenset(get_args(Ability))


EXTERNAL = External()
