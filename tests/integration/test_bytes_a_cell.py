"""The bytes of a cell on SQLite: counted, so that they are the same on every machine."""

from collections.abc import Sequence
from dataclasses import replace
from math import sin
from typing import Any

import pytest
from sqlalchemy import text
from tests.support.computed import ComputedBackend, computed
from tests.support.runs import EXPERT_SPACE, post_map, run, submit

from drivecal.campaigns.resolve.maps import stored_map
from drivecal.contracts.work import Cell, CellResult
from drivecal.reduction.keys import ReferenceKeys
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps, reference_keys

MOST_BYTES = 710
"""695 when it was counted: 271 in runs, 136 in evaluations, 49 in reference keys, 35 in ratings, the rest in indexes and parameter sets."""

SCENARIOS = ("S1", "S2", "S3", "S4", "S5", "S6")
METRICS = (
    *("comfort", "peak_lateral_acceleration_mps2", "peak_lateral_jerk_mps3", "peak_longitudinal_acceleration_mps2"),
    *("peak_longitudinal_jerk_mps3", "lateral_acceleration_rms_mps2", "longitudinal_acceleration_rms_mps2"),
    *("peak_yaw_rate_radps", "offset_rms_m", "offset_peak_m", "offset_overshoot_m", "steering_reversals_per_minute"),
    *("iso2631_lateral_rms_mps2", "iso2631_longitudinal_rms_mps2", "iso2631_horizontal_rms_mps2"),
    *("iso2631_lateral_msdv_mps15", "iso2631_longitudinal_msdv_mps15"),
)


def measured(scenario: str, cell: Cell) -> CellResult:
    """Returns as many metrics, of the same length, as a run of the built-in problem."""
    result = computed(scenario, cell)
    values = [result.rating or 0.0, *(sin(cell.id * factor) for factor in range(2, len(METRICS) + 1))]
    return replace(result, milliseconds=40.0 + cell.id % 1000 / 7, metrics=dict(zip(METRICS, values, strict=True)))


def index_references(database: Database) -> None:
    """Computes the reference keys of all runs, as the next campaign on the map does."""
    with database.read() as connection:
        [listed], _ = influence_maps.page(connection)
        the_map, indexes = (
            stored_map(influence_maps.get(connection, listed.id)),
            connection.execute(text("SELECT * FROM reference_indexes")).all(),
        )
        scenarios = {row.id: row.scenario for row in connection.execute(text("SELECT id, scenario FROM setups"))}
        newest = connection.scalar(text("SELECT max(id) FROM runs")) or 0
    for index in indexes:
        scenario = scenarios[index.setup_id]

        def keys(names: tuple[str, ...], values: Any, scenario: str = scenario) -> Sequence[bytes]:
            return ReferenceKeys(the_map, scenario, names).keys(values)

        reference_keys.sync(database, index.influence_map_sequence, index.setup_id, index.evaluator, newest, keys)


def counted(database: Database) -> tuple[int, int, int]:
    """Bytes in use, cells and simulated runs."""
    with database.read() as connection:
        used, free, page = (connection.scalar(text(f"PRAGMA {name}")) for name in ("page_count", "freelist_count", "page_size"))
        cells, simulated = (connection.scalar(text(f"SELECT count(*) FROM {table}")) for table in ("evaluations", "runs"))
    return (used - free) * page, cells, simulated


@pytest.mark.slow
def test_a_cell_with_its_run_takes_no_more_bytes_than_promised(database: Database) -> None:
    regions = {"P2": {"influential": True, "lower": 0.5, "upper": 0.5}, "P9": {"influential": False}}
    stored = post_map(database, dict.fromkeys(SCENARIOS, regions))
    empty, *_ = counted(database)
    space = [parameter | {"step": 0.01} for parameter in EXPERT_SPACE]
    search = {"kind": "genetic", "population": 250, "iterations": 3, "seed": 1}
    campaign = submit(database, stored_map=stored, parameters=space, catalogue=list(SCENARIOS), optimizer=search)
    run(database, campaign, ComputedBackend(answer=measured))
    index_references(database)
    full, cells, simulated = counted(database)
    assert cells > 2_000
    assert simulated > 0.95 * cells
    assert (full - empty) / cells <= MOST_BYTES
