"""A curve that falls: the distance of some of its points from the wanted ones."""

from typing import Any

WANTED = [1.84, 1.62, 1.30, 0.98, 0.74, 0.40, 0.22, 0.10]  # falls, as the constraint asks


def evaluate(parameters: dict[str, Any], scenario: dict[str, Any]) -> dict[str, Any]:
    """Returns the measures of one run."""
    off = [abs(parameters[f"k{i}"] - WANTED[i]) for i in scenario["points"]]
    return {"distance": sum(off) + abs(parameters["headway"] - 1.5)}
