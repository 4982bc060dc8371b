"""`drivecal compare-optimizers` against a real server whose dispatcher drives on formulas."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from typing import Any

import pytest
from tests.support.command import Run
from tests.support.comparisons import TWO_OPTIMIZERS
from tests.support.computed import ComputedBackend
from tests.support.runs import nothing_matters, post_map, working
from tests.support.server import RunningApi, serving

SMALL: dict[str, Any] = TWO_OPTIMIZERS | {"name": "small", "populations": [6]}


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningApi]:
    with (
        serving(f"sqlite:///{tmp_path_factory.mktemp('compared') / 'drivecal.db'}") as running,
        working(running.database, ComputedBackend()),
    ):
        yield running


@pytest.fixture(scope="module")
def ended(api: RunningApi) -> dict[str, Any]:
    """A comparison of two optimizers with and without a map that denies every influence, as the command's JSON gives it at its end."""
    stored = post_map(api.database, nothing_matters())
    document = SMALL | {
        "sensitivity": {"map": stored},
        "reductions": ["exact", {"mode": "influence", "audit": 0.0, "max_error": 1}],
    }
    environment = pytest.MonkeyPatch()
    environment.setenv("DRIVECAL_URL", api.url)
    from tests.support.command import command

    result = command("compare-optimizers", "-", "--wait", "--json", stdin=json.dumps(document))
    environment.undo()
    assert result.exit_code == 0, result.output
    assert "12 of 12" in result.stderr
    found: dict[str, Any] = json.loads(result.stdout)
    return found


def test_a_comparison_gives_table_5_and_what_the_reduction_changed(ended: dict[str, Any]) -> None:
    assert (ended["kind"], ended["state"], len(ended["runs"])) == ("comparison", "succeeded", 12)
    conditions = [(one["optimizer"], one["seed"], one["reduction"]) for one in ended["runs"][:3]]
    assert conditions == [("genetic", 1, "exact"), ("genetic", 1, "influence audit=0.0 max_error=1.0"), ("genetic", 2, "exact")]
    for group in ended["groups"]:
        runs = [
            one for one in ended["runs"] if (one["optimizer"], one["reduction"]) == (group["optimizer"], group["reduction"])
        ]
        optima = [one["simulated_best"] for one in runs]
        assert (group["best"], group["minimum"]) == (max(optima), min(optima))
        assert group["mean"] == pytest.approx(sum(optima) / 3)
        assert group["simulations"] == pytest.approx(sum(one["simulations"] for one in runs) / 3)
        assert group["converged"] == sum(one["converged_at"] is not None for one in runs)
        assert group["successes"] == sum(one["success"] for one in runs)
    assert max(one["best"] for one in ended["runs"]) == ended["best"]["objective"]
    assert all(one["simulated_best"] == one["best"] for one in ended["runs"] if one["reduction"] == "exact")
    assert [(one["optimizer"], one["pairs"]) for one in ended["effects"]] == [("genetic", 3), ("swarm", 3), (None, 6)]
    assert ended["effects"][2]["saved_share"] > 0.5, "a map that denies everything saves nearly everything"
    assert sum(one["difference"] for one in ended["pairs"]) == pytest.approx(6 * ended["effects"][2]["mean_difference"])


def test_every_run_is_a_campaign_that_can_be_read_but_not_steered(run: Run, api: RunningApi, ended: dict[str, Any]) -> None:
    first = ended["runs"][0]
    campaign = api.http.get(f"/api/v1/campaigns/{first['run']}").json()
    assert campaign["name"] == "genetic, population 6, seed 1, exact"
    assert campaign["links"]["run_of"] == f"/api/v1/campaigns/{ended['id']}"
    assert campaign["cells"]["simulated"] == first["simulations"]
    assert len(api.http.get(campaign["links"]["generations"]).json()["items"]) == 3
    refused = api.http.post(f"/api/v1/campaigns/{first['run']}/cancel")
    assert (refused.status_code, ended["id"] in refused.text) == (409, True)
    for table in ("solutions", "accounting", "setup"):
        answer = api.http.get(f"/api/v1/campaigns/{ended['id']}/{table}")
        assert answer.status_code == 409
    assert api.http.get(f"/api/v1/campaigns/{first['run']}/comparison").status_code == 409
    assert run("rerun", ended["id"], "--weights", "S1=2").exit_code == 1


def test_it_is_shown_listed_and_exported(run: Run, ended: dict[str, Any]) -> None:
    shown = run("show", ended["id"][:12])
    assert shown.exit_code == 0
    lines = shown.stdout.splitlines()
    table = next(index for index, line in enumerate(lines) if line.startswith("optimizer"))
    assert lines[table].split()[:6] == ["optimizer", "population", "reduction", "best", "mean", "worst"]
    assert [line.split()[0] for line in lines[table + 1 : table + 5]] == ["genetic", "genetic", "swarm", "swarm"]
    assert "influence audit=0.0 max_error=1.0 - exact" in shown.stdout
    assert [line.split()[0] for line in run("list").stdout.splitlines()[1:]] == [ended["id"]]
    for name, rows in (("comparison", "runs"), ("comparison-groups", "groups"), ("comparison-effects", "effects")):
        exported = list(csv.DictReader(io.StringIO(run("export", ended["id"], "--table", name).stdout)))
        assert [row["optimizer"] for row in exported] == [one["optimizer"] or "" for one in ended[rows]]


def test_a_dry_run_says_how_long_it_takes_at_most(run: Run, ended: dict[str, Any]) -> None:
    del ended  # its runs tell what one takes
    result = run("compare-optimizers", "-", "--dry-run", stdin=json.dumps(SMALL))
    assert result.exit_code == 0, result.output
    assert "216 cells" in result.stdout
    expected = json.loads(run("compare-optimizers", "-", "--dry-run", "--json", stdin=json.dumps(SMALL)).stdout)
    assert expected["at_most"] == 3 * 2 * ((6 + 2 * 1) + 3 * 6)
    assert expected["milliseconds"] == 7.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"optimizers": [{"kind": "swarm", "c1": 1.5}]}, "optimizers[0].c1: 1.5 is too large; give at most 1"),
        ({"optimizers": [{"kind": "genetic"}, {"kind": "annealing"}]}, "optimizers[1].kind: there is no optimizer 'annealing'"),
        (
            {"optimizers": [{"kind": "random"}, {"kind": "random"}]},
            "optimizers[1].label: it is called 'random' as optimizers[0]",
        ),
        (
            {"optimizers": [{"kind": "random", "seed": 3}]},
            "optimizers[0].seed: all optimizers have the same here; give it in `seeds`",
        ),
        ({"optimizers": []}, "optimizers: a list has too few entries; give at least 1"),
        ({"populations": []}, "populations: a list has too few entries; give at least 1"),
        ({"seeds": [1, 2]}, "seeds: a list has too few entries; give at least 3"),
        ({"seeds": [1, 2, 1]}, "seeds[2]: 1 is listed twice; list each once"),
        ({"reductions": ["exact", "influence"]}, "standard input: sensitivity: "),
        ({"reductions": ["exact", {"mode": "exact"}]}, "reductions[1]: exact is listed twice"),
        (
            {"populations": [100_000], "iterations": 10_000},
            "populations: the 6 runs of the comparison may propose 12,000,000,000",
        ),
        ({"seeds": list(range(600))}, "optimizers x populations x seeds x reductions are 1,200 runs"),
        ({"catalogue": ["S9"]}, "catalogue[0]: there is no scenario 'S9'"),
    ],
)
def test_what_cannot_be_compared_is_refused_at_its_field(run: Run, changes: dict[str, Any], words: str) -> None:
    result = run("compare-optimizers", "-", stdin=json.dumps(SMALL | changes))
    assert result.exit_code == 2
    assert words in result.stderr
