"""Answers about a campaign's setup: its problem and all that decides its runs."""

from pydantic import Field, computed_field

from drivecal.contracts.campaign import Answer
from drivecal.contracts.tables import parameter_column


class SearchedParameter(Answer):
    """A parameter with `n_values` values from `lower` to `upper`; `fixed`: the value at which it is held, null if it is searched.

    `kind`: grid, continuous, integer or choice. `lower` and `upper` of a choice are positions in `choices`.
    """

    name: str
    unit: str
    lower: float
    upper: float
    n_values: int
    fixed: float | str | None
    kind: str = "grid"
    choices: list[str] = Field(default_factory=list)
    description: str = ""
    """Its meaning, empty if the problem has none."""

    @computed_field  # type: ignore[prop-decorator]  # pydantic's own way
    @property
    def column(self) -> str:
        """Its column in tables."""
        return parameter_column(self.name)


class ScenarioSetup(Answer):
    """Setup of a scenario. `weight` is its share of the objective. `fingerprint` is the content hash of the setup, and the key of its runs
    in the reference table. The setup's other fields are null before the first run is requested."""

    scenario: str
    weight: float
    fingerprint: str
    driving_function: str | None = None
    vehicle: str | None = None
    vehicle_parameters: dict[str, float] | None = None
    simulator: str | None = None
    files: str | None = None
    """Digest of the problem's files except `problem.yaml`."""
    step_seconds: float | None = None
    seed: int | None = None
    title: str = ""
    """For readers, if the scenario's data has one."""


class CampaignSetup(Answer):
    """The parameters and setups of a campaign, `evaluator` with its version, the version of the server that answers, and the constraints on
    results in words."""

    evaluator: str
    parameters: list[SearchedParameter]
    scenarios: list[ScenarioSetup]
    server: str
    settings: dict[str, str] = Field(default_factory=dict)
    """Settings of the campaign in words, by name."""
    constraints: list[str] = Field(default_factory=list)
