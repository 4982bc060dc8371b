"""Answers about a campaign's setup: its problem and all that decides its runs."""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import Field, computed_field

from drivecal.contracts.campaign import Answer
from drivecal.contracts.tables import parameter_column
from drivecal.domain.values import Points, Setting


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


class GoodSets(Answer):
    """The range of a curve or map over sets whose objective lies `within` the tolerance of the best, or 1 % of the score's range."""

    sets: int
    """Their number."""
    within: float
    lower: Points
    upper: Points
    """Smallest and largest value at each support point."""


class ShapeAnswer(Answer):
    """A curve or a map: which parameters are its coefficients, and how they give the values at its support points.

    A value is the sum of the coefficients, each times its weights along all axes, rounded to `lower` plus a multiple of `step`, if any.
    """

    names: list[str]
    """Its parameters, of a map in rows along its second axis."""
    axes: list[list[float]]
    """Support points along each axis, in `axis_units`."""
    axis_units: list[str]
    weights: list[list[list[float]]]
    """Weights along each axis: a row for each support point, with a weight for each coefficient."""
    lower: float
    upper: float
    step: float | None
    unit: str
    description: str
    good: GoodSets | None = None
    """The range of a campaign's good sets, once it has some."""

    def values(self, parameters: Mapping[str, float | str]) -> Points:
        """Returns the values at the support points: a list, of a map a list for each point of x.

        Args:
            parameters: a value for each of `names`, and others.
        """
        return points_at(self.weights, [parameters[name] for name in self.names], self.lower, self.upper, self.step)


def points_at(weights: Sequence[Any], coefficients: list[Setting], lower: float, upper: float, step: float | None) -> Points:
    """Returns the values at the support points of a curve, of a map a list for each point of x; on the grid from `lower` on."""
    import numpy as np  # the command line starts without it

    values = np.array(coefficients, dtype=np.float64).reshape([np.shape(along)[1] for along in weights])
    for along in weights:
        values = np.moveaxis(np.tensordot(along, values, axes=(1, 0)), 0, -1)
    values = np.clip(values, lower, upper)
    points: Points = (np.round(lower + np.rint((values - lower) / step) * step if step else values, 9) + 0.0).tolist()
    return points


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
    shapes: dict[str, ShapeAnswer] = Field(default_factory=dict)
    """Curves and maps by name, whose coefficients are parameters."""
