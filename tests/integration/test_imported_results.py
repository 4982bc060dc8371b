"""Results of vehicles and test benches are compared with simulations, and are never taken for one."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from tests.support.command import command
from tests.support.computed import ComputedBackend
from tests.support.problems import MANIFEST, heated, push
from tests.support.runs import working
from tests.support.server import RunningApi, new_database, problem_of, serving

from drivecal.client import Client
from drivecal.domain.errors import ConflictError, InvalidInputError

SET: dict[str, float | str] = {"gain": 0.5, "stage": 1.0, "rooms": 3, "mode": "normal"}
HEAD: dict[str, Any] = {"problem": "heater", "source": "house 7", "date": "2026-11-20"}


def row(scenario: str = "winter", **values: Any) -> dict[str, Any]:
    return {"parameters": SET, "scenario": scenario} | (values or {"scores": {"cost": 30.0}})


@pytest.fixture(params=["sqlite", "postgresql"])
def api(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[RunningApi]:
    with serving(new_database(request, request.param, tmp_path)) as running:
        push(running.database, tmp_path / "heater")
        yield running


def simulated(client: Client, **more: Any) -> dict[str, Any]:
    evaluation = client.evaluate({"problem": "heater", "parameters": SET} | more)
    while (evaluation := client.evaluation(evaluation.id)).state not in {"succeeded", "failed"}:
        pass
    return {item.scenario: item for item in evaluation.items}


def test_results_from_elsewhere_stand_beside_simulations_and_answer_no_cell(api: RunningApi) -> None:
    backend = ComputedBackend(answer=heated)
    measured = row(measures={"energy_kwh": 1.5, "discomfort": 2.0})
    with Client(api.url) as client:
        assert client.import_results([row("spring"), measured], **HEAD, units={"discomfort": "K"}) == 2
        assert client.import_results([measured], **HEAD) == 0
        before = client.imported("heater")
        assert [(item.simulated, item.difference) for item in before] == [(None, None)] * 4
        with working(api.database, backend):
            cells = simulated(client)
        assert {cell.outcome for cell in cells.values()} == {"simulated"}
        after = {(item.scenario, item.kind, item.name): item for item in client.imported("heater", "house 7")}
    assert {key: item.value for key, item in after.items()} == {
        ("spring", "score", "cost"): 30.0,
        ("winter", "score", "cost"): 25.0,  # by the formula
        ("winter", "measure", "energy_kwh"): 1.5,
        ("winter", "measure", "discomfort"): 2.0,
    }
    own = cells["winter"]
    assert after["winter", "score", "cost"].difference == pytest.approx(25.0 - own.score)
    assert after["winter", "measure", "discomfort"].simulated == own.metrics["discomfort"]
    table = api.http.get("/api/v1/results", params={"problem": "heater", "format": "csv"}).text.splitlines()
    assert table[0].startswith(
        "source,date,owner,scenario,gain,parameter_stage,rooms,mode,kind,name,unit,value,simulated,difference"
    )
    assert len(table) == 5


@pytest.mark.slow("postgresql")
def test_rows_outside_of_the_ranges_are_kept_and_counted(api: RunningApi) -> None:
    inside, outside = row(), row("spring", scores={"cost": 31.0}) | {"parameters": SET | {"gain": 50.0}}
    answer = api.http.post("/api/v1/results", json={**HEAD, "rows": [inside, outside]}).json()
    assert (answer["stored"], len(answer["notes"])) == (2, 1)
    assert answer["notes"][0].startswith("gain: 1 of 2 ")


@pytest.mark.slow("sqlite")
def test_a_cell_has_one_value_of_a_source_and_day_until_the_source_is_deleted(api: RunningApi) -> None:
    with Client(api.url) as client:
        client.import_results([row()], **HEAD)
        with pytest.raises(ConflictError):
            client.import_results([row("spring"), row(scores={"cost": 31.0})], **HEAD)
        with pytest.raises(ConflictError):
            client.import_results([row("spring"), row("spring"), row("spring", scores={"cost": 31.0})], **HEAD)
        with pytest.raises(InvalidInputError) as refused:
            client.import_results([row()] * 1400 + [row("summer")], **HEAD)
        assert refused.value.problems[0].field == "rows[1400].scenario"
        (imported,) = client.imported("heater")
        assert client.imported(client.problem("heater").digest) == [imported]
        assert client.import_results([row(scores={"cost": 31.0})], **HEAD | {"date": "2026-11-21"}) == 1
        assert client.delete_imported("heater", "house 7") == 2
        assert client.imported("heater") == []


@pytest.mark.slow("postgresql")
def test_a_score_that_was_renamed_since_is_listed_as_it_was_imported(api: RunningApi, tmp_path: Path) -> None:
    with Client(api.url) as client:
        client.import_results([row(scores={"ease": 3.0})], **HEAD)
        push(api.database, tmp_path / "heater", scores={"cost": MANIFEST["scores"]["cost"]})
        assert [(item.name, item.value, item.simulated) for item in client.imported("heater")] == [("ease", 3.0, None)]


@pytest.mark.slow("sqlite")
def test_results_that_come_at_once_are_stored_or_refused(api: RunningApi) -> None:
    def posted(number: int) -> int:
        return api.http.post("/api/v1/results", json=HEAD | {"rows": [row(scores={"cost": float(number)})]}).status_code

    with ThreadPoolExecutor(8) as pool:
        assert sorted(pool.map(posted, range(8))) == [201, *[409] * 7]


@pytest.mark.slow("postgresql")
def test_a_search_starts_with_the_sets_of_a_source_and_simulates_them(api: RunningApi) -> None:
    search = {"kind": "random", "population": 6, "iterations": 1, "start_results": "house 7"}
    spec = {"problem": "heater", "reduction": {"mode": "exact"}, "fixed": {"mode": "normal"}, "optimizer": search}
    with Client(api.url) as client:
        client.import_results([row(), row() | {"parameters": SET | {"stage": 2.2}}], **HEAD)
        campaign = client.submit(spec)
        assert campaign.spec["optimizer"]["start_sets"] == [SET, SET | {"stage": 2.0}]
        with working(api.database, ComputedBackend(answer=heated)):
            client.wait(campaign.id)
        for begun in campaign.spec["optimizer"]["start_sets"]:
            assert len(client.look_up([begun], problem="heater").items) == 2
        differences = [item.difference for item in client.imported("heater")]
        assert [difference is None for difference in differences] == [False, True]  # no run of the very set off the grid
        client.import_results([row() | {"parameters": SET | {"rooms": 9}}], **HEAD | {"source": "house 8"})
        few: dict[str, Any] = {"population": 2, "start_sets": [SET | {"rooms": 2}]}
        for changes in ({"start_results": "house 8"}, {"start_results": "house 9"}, few):
            refused = api.http.post("/api/v1/campaigns", json=spec | {"optimizer": search | changes})
            assert problem_of(refused, 422)["errors"][0]["field"] == "optimizer.start_results"
        begun = campaign.spec["optimizer"]
        for changed in ({}, {"kind": "genetic", "population": 6}, few | {"population": 6}):
            again = client.rerun(campaign.id, {"weights": {}, "optimizer": changed}).spec["optimizer"]
            assert (again["start_results"], again["start_sets"][-2:]) == ("house 7", begun["start_sets"])
        for names, code in ((("heater", "house 77"), 5), (("heatre", "house 7"), 5), (("heater", "house 7"), 0)):
            assert command("results", "delete", *names, "--url", api.url).exit_code == code
        assert client.rerun(campaign.id, {"weights": {"winter": 1}}).spec["optimizer"] == begun


@pytest.mark.slow("postgresql")
def test_sets_of_another_curve_begin_no_search_and_have_no_simulation(api: RunningApi, tmp_path: Path) -> None:
    def pushed(*axis: int) -> None:
        tank = {"tank": {"curve": {"axis": axis}, "lower": 0, "upper": 9, "coefficients": 2}}
        push(api.database, tmp_path / "heater", parameters=MANIFEST["parameters"] | tank, baseline=None)

    pushed(0, 5, 9)
    given = row() | {"parameters": SET | {"tank": [0, 5, 9]}}
    search = {
        "problem": "heater",
        "optimizer": {"kind": "random", "population": 2, "iterations": 1, "start_results": "house 7"},
    }
    with Client(api.url) as client:
        client.import_results([given], **HEAD)
        with working(api.database, ComputedBackend(answer=heated)):
            simulated(client, parameters=given["parameters"])
        assert [item.difference is None for item in client.imported("heater")] == [False]
        nearly = SET | {"tank": [0, 1, 9]}
        with pytest.warns(UserWarning, match=r"rows\[0\]\.parameters\.tank"):
            client.import_results([given | {"parameters": nearly}], **HEAD | {"source": "house 8"})
        asked = client.ask_tell({"problem": "heater"}).campaign
        with pytest.warns(UserWarning, match=r"sets\[0\]\.parameters\.tank"):
            client.propose(asked.id, [{"key": "a", "parameters": nearly}])
        client.delete_imported("heater", "house 8")
        pushed(0, 1, 9)
        assert [item.difference for item in client.imported("heater")] == [None]
        refused = api.http.post("/api/v1/campaigns", json=search)
        assert problem_of(refused, 422)["errors"][0]["field"] == "optimizer.start_results"


def test_results_that_do_not_fit_the_problem_are_refused_by_field(request: pytest.FixtureRequest, tmp_path: Path) -> None:
    faulty: list[tuple[dict[str, Any], str]] = [
        ({"units": {"discomfort": "mK"}}, "units.discomfort"),
        ({"units": {"gap": "m"}}, "units.gap"),
        ({"rows": [row("summer")]}, "rows[0].scenario"),
        ({"rows": [row(scores={"comfort": 1.0})]}, "rows[0].scores.comfort"),
        (
            {"rows": [row(), {"parameters": {"gain": 1.0}, "scenario": "winter", "scores": {"cost": 1}}]},
            "rows[1].parameters.stage",
        ),
        (
            {"rows": [{"parameters": SET | {"mode": "turbo"}, "scenario": "winter", "scores": {"cost": 1}}]},
            "rows[0].parameters.mode",
        ),
        (
            {"rows": [{"parameters": SET | {"gain": "much"}, "scenario": "winter", "scores": {"cost": 1}}]},
            "rows[0].parameters.gain",
        ),
        ({"source": "house\0"}, "source"),
        ({"date": "20th of November"}, "date"),
        ({"date": "1767225600"}, "date"),
        ({"date": 0}, "date"),
        ({"problem": "cooler"}, "problem"),
    ]
    with serving(new_database(request, "sqlite", tmp_path)) as api:
        push(api.database, tmp_path / "heater")
        for changes, field in faulty:
            refused = api.http.post("/api/v1/results", json=HEAD | {"rows": [row()]} | changes)
            assert problem_of(refused, 422)["errors"][0]["field"] == field


@pytest.mark.slow("postgresql")
def test_a_look_up_finds_runs_that_another_score_has_rated(api: RunningApi) -> None:
    with Client(api.url) as client:
        with working(api.database, ComputedBackend(answer=heated)):
            cells = simulated(client)
        listed = client.look_up([SET], problem="heater", evaluator="ease").items
    expected = {name: 10 - (cell.metrics["discomfort"] or 0.0) for name, cell in cells.items()}
    assert {cell.scenario: cell.score for cell in listed} == pytest.approx(expected)
