"""Influential bounds as a table, and the basis of the map."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from drivecal.contracts.campaign import CellCounts
from drivecal.contracts.tables import InfluenceRow
from drivecal.report.markup import paragraph, table
from drivecal.report.rows import Emphasized, by_scenario
from drivecal.sensitivity.thresholds import caveats


def parts(
    rows: Sequence[InfluenceRow], basis: Mapping[str, Any] | None, drawings: Sequence[str], counts: CellCounts
) -> list[str]:
    """Returns the section: the basis of the map, Figure 9, and the bounds as a table. `counts`: of the search."""
    if not rows:
        return [paragraph(_without(counts))]
    scenarios = by_scenario(rows)
    cells = {(row.scenario, row.parameter): _bounds(row) for row in rows}
    names = list(dict.fromkeys(row.parameter for row in rows))
    lines = [[name, *(cells.get((scenario, name)) for scenario in scenarios)] for name in names]
    caption = "Influential bounds in parameter units, inclusive; a dash where nothing is influential"
    return [paragraph(_origin(basis)), *drawings, table(["parameter", *scenarios], lines, caption)]


def _without(counts: CellCounts) -> str:
    ways = {"predictions": counts.predicted, "references": counts.reused, "certificates": counts.certified}
    used = [name for name, count in ways.items() if count]
    if not used:
        return "No influence map is in use, so only equal parameter sets are answered without a simulation."
    return f"No influence map is in use; equal parameter sets and {' and '.join(used)} answer cells without a simulation."


def _origin(basis: Mapping[str, Any] | None) -> str:
    if basis is None:
        return "The influence map was posted by a user; no analysis stands behind it."
    settings = basis["sensitivity"]
    ends = "".join(f" {line[0].upper()}{line[1:]}." for line in caveats(settings))
    return (
        f"An analysis by elementary effects: design {settings['design']}, {settings['intervals']} intervals, {settings['samples']} "
        f"samples, threshold {json.dumps(settings['threshold'])}, seed {settings['seed']}; {basis['runs']:,} runs asked for, "
        f"{basis['simulated']:,} simulated for it.{ends}"
    )


def _bounds(row: InfluenceRow) -> str | None:
    if not row.influential:
        return None
    if row.unknown:
        return Emphasized("unknown")
    if (row.lower, row.upper) == (row.space_lower, row.space_upper):
        return Emphasized("everywhere")
    return Emphasized(" … ".join("" if end is None else f"{end:g}" for end in (row.lower, row.upper)))
