"""Answers about the savings and costs of reuse."""

from typing import Literal

from pydantic import Field

from drivecal.contracts.campaign import Answer, OutcomeCounts


class SensitivityCost(OutcomeCounts):
    """Cost of a sensitivity stage: requested cells, simulated runs, CPU seconds of the workers."""

    seconds: float = 0.0


class MapCost(Answer):
    """The influence map in use and its cost. `paid_here`: by this campaign's own sensitivity stage; else by `made_by`, an
    earlier campaign's id (null: expert knowledge)."""

    id: str
    made_by: str | None
    paid_here: bool
    runs: int
    seconds: float


class ScenarioAccount(OutcomeCounts):
    """The calibration stage in one scenario. `mean_seconds`: CPU time of a simulation, over the simulated cells; if
    there is none, over the simulated runs that answered cells; null if there is neither. `saved`: seconds by outcome, the number of its
    cells times the mean. `predictor_seconds`: CPU time of the predictor. `confirmed`: of the reused cells, those that were simulated after
    the search to confirm its best set, and so save nothing."""

    scenario: str
    audited: int
    confirmed: int = 0
    mean_seconds: float | None
    simulated_seconds: float
    audited_seconds: float
    saved: dict[str, float]
    predictor_seconds: float = 0.0


class BreakEven(Answer):
    """Break-even of a map: its cost against the savings of reuse at the share observed in this campaign.

    `requested_cells`: from so many requested cells on; `campaigns`: from so many campaigns like this one on the same map, the first
    included; `reruns`: the same without the first. All null if nothing was reused, so that the map never pays at that share.
    """

    requested_cells: int | None
    campaigns: int | None
    reruns: int | None


class BalanceItem(Answer):
    """An addend of the net, in seconds: positive if saved, negative if spent. `name`: an outcome of cells, or what saving took; `label`:
    the same in words."""

    name: str
    label: str
    seconds: float


class Accounting(Answer):
    """Savings and costs of a campaign, in cells and in CPU seconds of the workers.

    `saved_seconds`: by repeated, reused and predicted cells, without those that were `confirmed`. `audited_seconds` is
    the price of the self-check: audited cells could have been reused but were simulated, so they are not among the saved, and are not
    taken off once more. `net_seconds`, the sum of the `balance`: what was saved less what saving took in this campaign, an estimate of the
    CPU time of the same campaign without reuse, less its own. `map_net_seconds` = saved by reuse alone - cost of the map, in any campaign;
    null without a map. `share_without_simulation`: (repeated + reused + predicted) / requested; `share_reused`: reused / requested; null
    before the first.

    `clock`: `cpu`, or `wall` if runs take more than twice their CPU time: then all seconds of simulations are wall-clock time of the
    workers, because CPU time would say nothing about what was saved. `cpu_seconds`, `wall_seconds`: what the runs that answered
    cells took by either.

    `pruned`: most cells of the campaign were removed. The account then counts only those that are left, without the map. `map` is null as
    well if the campaign that made it was pruned.
    """

    campaign: str
    state: str
    pruned: bool = False
    clock: Literal["cpu", "wall"] = "cpu"
    cpu_seconds: float = 0.0
    wall_seconds: float = 0.0
    sensitivity: SensitivityCost
    map: MapCost | None
    scenarios: list[ScenarioAccount]
    requested: int
    answered_without_simulation: int
    simulated: int
    audited: int
    share_without_simulation: float | None
    share_reused: float | None
    simulated_seconds: float
    audited_seconds: float
    saved_seconds: float
    net_seconds: float
    map_net_seconds: float | None
    break_even: BreakEven | None
    """Null without a map, or with a map without a known cost."""
    balance: list[BalanceItem] = Field(default_factory=list)
    """The addends of `net_seconds` that are not 0."""
    remarks: list[str] = Field(default_factory=list)
    """Sentences about audits, confirmations, the map and its break-even."""
    sentence: str
