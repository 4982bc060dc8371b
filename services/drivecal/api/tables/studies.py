"""The rows of what the stages after the calibration found, whole for JSON or flat for tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from drivecal.api.responses import parameter_column
from drivecal.api.tables.files import Column, Row
from drivecal.contracts.studies import RobustnessRow, ValidationRow

ROBUSTNESS = ("rank", "objective", "rating", "degree", "at_least", "radius", "recommended", "reason", "region", "to_worse")
_KINDS = {
    "rank": "integer",
    "degree": "integer",
    "region": "integer",
    "at_least": "truth",
    "recommended": "truth",
    "reason": "text",
}


def robustness_row(found: dict[str, Any], *, flat: bool) -> Row:
    """One examined set."""
    row = RobustnessRow.model_validate(found)
    if not flat:
        return row.model_dump(mode="json")
    flat_row: dict[str, Any] = row.model_dump(include=set(ROBUSTNESS))
    flat_row |= {f"score_{name}": score for name, score in row.scores.items()}
    return flat_row | {parameter_column(name): value for name, value in row.parameters.items()}


def robustness_columns(scenarios: Sequence[str], parameters: Sequence[str]) -> list[Column]:
    """Of `robustness_row`, flat."""
    return [
        *(Column(name, _KINDS.get(name, "number")) for name in ROBUSTNESS),  # type: ignore[arg-type]  # kinds are literals
        *(Column(f"score_{name}", "integer") for name in scenarios),
        *(Column(parameter_column(name), "number") for name in parameters),
    ]


def validation_row(found: dict[str, Any], *, flat: bool) -> Row:
    """One scenario. Flat, its histogram is a list of counts for differences from -7 to 7."""
    row = ValidationRow.model_validate(found)
    document = row.model_dump(mode="json")
    if flat:
        document["histogram"] = [float(row.histogram.get(points, 0)) for points in range(-7, 8)]
    return document


def validation_columns() -> list[Column]:
    """Of `validation_row`, flat."""
    counts = ("reducible", "effects", "covered", "drawn", "bases", "references", "compared", "wrong", "different")
    return [
        Column("scenario", "text"),
        *(Column(name, "integer") for name in counts),
        *(Column(name, "number") for name in ("error_rate", "lower_95", "upper_95")),
        Column("histogram", "numbers"),
    ]
