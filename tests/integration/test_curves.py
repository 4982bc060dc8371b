"""A campaign on a curve: coefficients are searched, results show values at the support points and the range of good sets."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

import numpy as np
import pytest
from tests.support.computed import ComputedBackend
from tests.support.problems import scored, store, submit_checked
from tests.support.runs import run

from drivecal.api.results.document import results_of, setup_of
from drivecal.api.routes.campaigns import read
from drivecal.api.tables.ranking import ranking_of
from drivecal.bundles.shapes import Shape, with_points
from drivecal.campaigns.results.front import StoredRanking
from drivecal.cli.views.output import print_results, print_solutions
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.work import Cell, CellResult, SetupRequest
from drivecal.storage.engine.database import Database
from drivecal.storage.results import answers

WANTED = [3.0, 2.2, 1.4, 0.9, 0.8]
PARAMETERS: dict[str, Any] = {
    "gain": {
        "curve": {"axis": [0, 5, 10, 20, 40], "axis_unit": "m/s"},
        "lower": 0,
        "upper": 4,
        "monotone": "decreasing",
        "coefficients": 3,
        "unit": "1/s",
    },
    "load": {"map": {"x": [0, 1], "y": [0, 2, 4]}, "lower": 0, "upper": 1, "step": 0.1, "coefficients": 2},
}
MANIFEST = scored("curved", PARAMETERS, scenarios={"city": {}}) | {
    "baseline": {"gain": [2, 2, 2, 2, 2], "load": [[0, 0, 0], [0, 0, 0]]},
    "scores": {"cost": {"formula": "y", "direction": "minimise", "range": [0, 10], "tolerance": 0.2}},
}


def driven(setup: SetupRequest, cell: Cell) -> CellResult:
    """The distance of the curve from the wanted one, and of the map from 1 at its last point."""
    shapes = {name: Shape.from_document(name, document) for name, document in setup.shapes.items()}
    arguments = with_points(cell.parameters, shapes, setup.simulator)
    off = float(np.abs(np.array(arguments["gain"]) - WANTED).sum() + abs(np.array(arguments["load"])[-1, -1] - 1))
    return CellResult(cell.id, None, None, {"y": off}, None, 500.0)


def one_at_a_time(read: Callable[[Database], Any]) -> Callable[[Database], Any]:
    """Reads of a thread that never holds two connections."""
    held: list[Database] = []

    @contextmanager
    def reading(database: Database) -> Iterator[Any]:
        assert not held
        with read(database) as connection:
            held.append(database)
            try:
                yield connection
            finally:
                held.pop()

    return reading


@pytest.fixture
def database(database: Database) -> Database:
    """The problem is pushed."""
    store(database, MANIFEST)
    return database


@pytest.mark.slow
def test_results_show_curves_with_the_range_of_good_sets(database: Database, capsys: pytest.CaptureFixture[str]) -> None:
    wanted: dict[str, Any] = {"problem": "curved", "optimizer": {"kind": "surrogate", "seed": 1}, "variants": {"eu": {}}}
    wanted |= {"budget": {"simulations": 60}}
    ended = run(database, submit_checked(database, wanted), ComputedBackend(driven=driven))
    with mock.patch("drivecal.storage.results.answers", wraps=answers) as reads:
        results = results_of(StoredRanking.of(database, ended))
    assert reads.call_count == 1, "curves and variants are of one ranking"
    gain, load = results.setup.shapes["gain"], results.setup.shapes["load"]
    best, baseline = results.campaign.best, results.campaign.baseline
    assert best is not None
    assert baseline is not None
    assert gain.values(baseline.parameters) == [2, 2, 2, 2, 2]
    assert best.objective < (baseline.objective or 0)
    last = np.array(load.values(best.parameters))[-1, -1]
    assert best.objective == pytest.approx(np.abs(np.array(gain.values(best.parameters)) - WANTED).sum() + abs(last - 1))
    ends = next(verdict for verdict in results.trust.verdicts if verdict.code == "at_ends").numbers
    assert (list(ends["values"]), ends["entries"]) == (["load at 0.5, 4"], ["`upper: 1` of load"])
    assert gain.good is not None
    assert load.good is not None
    shown = np.array([gain.good.lower, gain.values(best.parameters), gain.good.upper])
    assert (np.diff(shown, axis=0) >= 0).all()
    with mock.patch.object(Database, "read", one_at_a_time(Database.read)):  # else requests wait for each other's connections
        in_notebook = Campaign.model_validate_json(bytes(read(ended.id, database).body))._repr_html_()
        with mock.patch("drivecal.storage.results.answers", wraps=answers) as reads:
            assert setup_of(ranking_of(database, ended.id)) == results.setup
            assert ranking_of(database, ended.id).sets.best()
        assert reads.call_count == 1, "the next page of a table needs no ranking of its own"
    assert all(str(points) in in_notebook for points in (gain.values(best.parameters), gain.good.lower, load.good.upper))
    print_results(results)
    print_solutions([each.best for each in results.variants if each.best], results.setup.shapes)
    printed = capsys.readouterr().out
    assert all(text in printed for text in ("gain (1/s)", "40 m/s", "y 4", "baseline", "best of eu", "rank 1"))
    assert "gain_1" not in printed + in_notebook


@pytest.mark.parametrize(
    ("answered", "changes"),
    [
        ("reused", {"sensitivity": {"intervals": 2, "samples": 8}, "reduction": {"mode": "influence", "max_error": 1}}),
        ("predicted", {"reduction": {"mode": "predicted", "tolerance": 1, "limit": 0.2}}),
    ],
)
def test_maps_and_predictions_answer_cells_of_curves(database: Database, answered: str, changes: dict[str, Any]) -> None:
    coarse = MANIFEST["parameters"]["gain"] | {"step": 0.5}
    store(database, MANIFEST | {"parameters": MANIFEST["parameters"] | {"gain": coarse}})
    search = {"kind": "genetic", "population": 160, "iterations": 3, "seed": 1}
    wanted = {"problem": "curved", "optimizer": search, **changes}
    ended = run(database, submit_checked(database, wanted), ComputedBackend(driven=driven))
    assert getattr(ended.cells, answered) > 0
