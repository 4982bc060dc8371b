"""Answers about the savings and costs of reuse."""

from typing import Literal

from pydantic import Field

from drivecal.contracts.campaign import Answer, OutcomeCounts


class SensitivityCost(OutcomeCounts):
    """Cost of a sensitivity stage: requested cells, simulated runs, CPU seconds of the workers."""

    seconds: float = 0.0


class MapCost(Answer):
    """The influence map in use and its cost. `paid_here` is true if this campaign's own sensitivity stage made it. `made_by` is the id of
    the campaign that made it, null for expert knowledge."""

    id: str
    made_by: str | None
    paid_here: bool
    runs: int
    seconds: float


class ScenarioAccount(OutcomeCounts):
    """The calibration stage in one scenario. `mean_seconds` is the mean CPU time of its simulated cells; without such cells, of the
    earlier simulations that answered its cells; null without either. `saved` has the saved seconds by outcome: number of cells times the
    mean. `predictor_seconds` is CPU time. `confirmed` counts cells that were simulated after the search to confirm the best set, and
    therefore save nothing."""

    scenario: str
    audited: int
    confirmed: int = 0
    mean_seconds: float | None
    simulated_seconds: float
    saved: dict[str, float]
    predictor_seconds: float = 0.0


class BreakEven(Answer):
    """Break-even of a map: its cost against the savings of reuse at the share observed in this campaign.

    `requested_cells` is the number of cells at which the map has paid. `campaigns` is the number of such campaigns on the same map, the
    first included; `reruns` the same without the first. All are null if nothing was reused: the map then never pays.
    """

    requested_cells: int | None
    campaigns: int | None
    reruns: int | None


class BalanceItem(Answer):
    """An addend of the net, in seconds: positive if saved, negative if spent. Its `name` is an outcome of cells, or the part of a campaign
    that cost time; `label` is the same in words."""

    name: str
    label: str
    seconds: float


class Accounting(Answer):
    """Savings and costs of a campaign, in cells and in CPU seconds of the workers.

    Repeated, reused and predicted cells save `saved_seconds`, unless they were `confirmed`. Audited cells are simulated, and save nothing.
    `net_seconds` is the sum of the `balance`: an estimate of the CPU time of the same campaign without reuse, less its own.

    `clock` is `wall` if runs take more than twice their CPU time, else `cpu`. With `wall` all seconds of simulations are wall-clock
    time of the workers. The runs that answered cells took `cpu_seconds` and `wall_seconds`.
    """

    clock: Literal["cpu", "wall"] = "cpu"
    cpu_seconds: float = 0.0
    wall_seconds: float = 0.0
    sensitivity: SensitivityCost
    map: MapCost | None
    scenarios: list[ScenarioAccount]
    runs: dict[str, int] = Field(default_factory=dict)
    """Starts of the simulator in all stages by what they were for, as `purpose` of the evaluations has it; all but the first one of a cell
    are `repeat`: a check that equal runs are equal, or after a breakdown or a lost worker."""
    saved_seconds: float
    net_seconds: float
    break_even: BreakEven | None
    """Null without a map, or with a map without a known cost."""
    balance: list[BalanceItem] = Field(default_factory=list)
    """The addends of `net_seconds` that are not 0."""
    remarks: list[str] = Field(default_factory=list)
    """Sentences about the runs, the map and its break-even."""
    sentence: str
