"""A driving function with parameters of every kind and constraints, for campaigns on a computed backend."""

from collections.abc import Mapping
from decimal import Decimal

from drivecal.bundles.highway import Scenario
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.constraints import Constraint
from drivecal.domain.parameters import Parameter
from drivecal.plugins.ports import Planner


class Mixed:
    """A driving function that is never driven."""

    name = "mixed"
    version = "1"
    spaces: Mapping[str, tuple[Parameter, ...]] = {
        "all": (
            Parameter.from_step("speed", Decimal(0), Decimal(100), None),
            Parameter.from_step("limit", Decimal(0), Decimal(100), Decimal("0.5")),
            Parameter.integer("gears", Decimal(1), Decimal(6)),
            Parameter.choice("mode", ["eco", "sport", "winter"]),
            Parameter.choice("tyre", ["a", "b"]),
        )
    }
    limits: Mapping[str, tuple[float | None, float | None]] = {}
    constraints: Mapping[str, Constraint] = {
        "speed <= limit": lambda values: values["speed"] <= values["limit"],
        "gears * 10 <= limit": lambda values: values["gears"] * 10 <= values["limit"],
    }

    def create(self, scenario: Scenario) -> Planner:
        raise NotImplementedError(scenario)


MIXED = Mixed()


def rated(scenario: str, cell: Cell) -> CellResult:
    """S1 depends on speed up to 40, on gears and on mode; S2 on limit. The tyre matters nowhere."""
    p = cell.parameters
    assert p["speed"] <= p["limit"]
    assert p["gears"] * 10 <= p["limit"]
    if scenario == "S1":
        rating = 4 * min(p["speed"], 40) / 40 + p["gears"] / 4 + {"eco": 0, "sport": 1.4, "winter": 0.6}[p["mode"]]
    else:
        rating = 6 * p["limit"] / 100
    return CellResult(cell.id, rating, round(rating), {"rating": rating}, None, 7.0)
