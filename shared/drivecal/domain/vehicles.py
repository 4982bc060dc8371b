"""Parameters of a vehicle model, with the bounds of the robustness study."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class VehicleParameter:
    """A physical parameter of a vehicle model in `unit`, with its nominal value and the bounds of Table 8."""

    name: str
    unit: str
    nominal: float
    minimum: float
    maximum: float
    description: str = ""
