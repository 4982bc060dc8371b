"""`drivecal compare-optimizers` against a real server whose dispatcher drives on formulas."""

import json
import time
from collections.abc import Iterator
from typing import Any

import pytest
from tests.support.command import Run, command
from tests.support.comparisons import TWO_OPTIMIZERS
from tests.support.computed import ComputedBackend
from tests.support.runs import nothing_matters, post_map, working
from tests.support.server import RunningApi

SMALL: dict[str, Any] = TWO_OPTIMIZERS | {"name": "small", "populations": [6]}


@pytest.fixture(scope="module", autouse=True)
def _dispatcher(api: RunningApi) -> Iterator[None]:
    with working(api.database, ComputedBackend()):
        yield


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
    result = command("compare-optimizers", "-", "--wait", "--json", stdin=json.dumps(document))
    environment.undo()
    assert result.exit_code == 0, result.output
    assert "12 of 12" in result.stderr
    answer: dict[str, Any] = json.loads(result.stdout)
    return answer


def test_a_comparison_gives_table_5_with_and_without_a_reduction(ended: dict[str, Any]) -> None:
    conditions = [(run["optimizer"], run["seed"], run["reduction"], run["state"]) for run in ended["runs"][:3]]
    assert conditions == [
        ("genetic", 1, "exact", "succeeded"),
        ("genetic", 1, "influence", "succeeded"),
        ("genetic", 2, "exact", "succeeded"),
    ]
    for each in ended["groups"]:
        runs = [run for run in ended["runs"] if (run["optimizer"], run["reduction"]) == (each["optimizer"], each["reduction"])]
        assert each["mean"] == pytest.approx(sum(run["simulated_best"] for run in runs) / 3)
        assert each["simulations"] == pytest.approx(sum(run["simulations"] for run in runs) / 3)
    assert all(run["simulated_best"] == run["best"] for run in ended["runs"] if run["reduction"] == "exact")
    exact, reduced = (each["simulations"] for each in ended["groups"][:2])
    assert reduced < 0.5 * exact, "a map that denies everything saves nearly everything"


def test_the_campaigns_are_listed_and_compared_by_their_tag(run: Run, api: RunningApi, ended: dict[str, Any]) -> None:
    first = ended["runs"][0]
    campaign = api.http.get(f"/api/v1/campaigns/{first['campaign']}").json()
    assert (campaign["name"], campaign["tags"]) == (first["name"], [ended["tag"]])
    assert campaign["cells"]["simulated"] == first["simulations"]
    listed = json.loads(run("list", "--tag", ended["tag"], "--json").stdout)["items"]
    assert [each["id"] for each in listed[::-1]] == [each["campaign"] for each in ended["runs"]]
    shown = run("compare-optimizers", "--tag", ended["tag"])
    lines = shown.stdout.splitlines()
    table = next(index for index, line in enumerate(lines) if line.startswith("optimizer"))
    assert lines[table].split()[:6] == ["optimizer", "population", "reduction", "best", "mean", "worst"]
    assert [line.split()[0] for line in lines[table + 1 : table + 5]] == ["genetic", "genetic", "swarm", "swarm"]
    assert run("compare-optimizers", "--tag", "nothing").exit_code == 5
    assert run("compare-optimizers").exit_code == 2


@pytest.mark.slow
def test_campaigns_of_a_tag_are_paused_cancelled_and_deleted_together(run: Run, api: RunningApi) -> None:
    large = SMALL | {"name": "large", "populations": [60], "iterations": 500}
    tag = json.loads(run("compare-optimizers", "-", "--json", stdin=json.dumps(large)).stdout)["tag"]
    for action, expected in {"pause": 6, "finish": 0, "cancel": 6}.items():  # each one refuses to finish: no program feeds it
        asked = json.loads(run(action, "--tag", tag, "--json").stdout)
        assert len(asked) == expected
    for each in asked:
        wait_for(api, each["id"])
    assert {row["state"] for row in json.loads(run("compare-optimizers", "--tag", tag, "--json").stdout)["runs"]} == {
        "cancelled"
    }
    assert run("compare-optimizers", "--tag", tag, "--wait").exit_code == 3
    assert len(json.loads(run("delete", "--tag", tag, "--json").stdout)["deleted"]) == 6
    assert run("delete", "--tag", tag).exit_code == 5


def wait_for(api: RunningApi, campaign: str) -> None:
    """Returns when a campaign has ended."""
    while api.http.get(f"/api/v1/campaigns/{campaign}").json()["state"] not in {"cancelled", "failed", "succeeded"}:
        time.sleep(0.1)


def test_a_dry_run_counts_cells_and_estimates_the_time(run: Run, ended: dict[str, Any]) -> None:
    assert ended["runs"], "whose simulations are the measure"
    expected = json.loads(run("compare-optimizers", "-", "--dry-run", "--json", stdin=json.dumps(SMALL)).stdout)
    assert (expected["runs"], expected["proposed"]) == (6, 216)
    assert expected["at_most"] == 3 * 2 * ((6 + 2 * 1) + 3 * 6)
    assert expected["milliseconds"] == 7.0
    assert run("compare-optimizers", "-", "--dry-run", stdin=json.dumps(SMALL)).exit_code == 0


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"optimizers": [{"kind": "swarm", "c1": 1.5}]}, "optimizers[0].c1"),
        ({"optimizers": [{"kind": "genetic"}, {"kind": "annealing"}]}, "optimizers[1].kind"),
        ({"optimizers": [{"kind": "random"}, {"kind": "random"}]}, "optimizers[1]"),
        ({"optimizers": [{"kind": "random", "seed": 3}]}, "optimizers[0].seed"),
        ({"optimizers": []}, "optimizers"),
        ({"populations": []}, "populations"),
        ({"seeds": [1, 2]}, "seeds"),
        ({"seeds": [1, 2, 1]}, "seeds[2]"),
        ({"reductions": ["exact", "influence"]}, "sensitivity"),
        ({"reductions": ["exact", {"mode": "exact"}]}, "reductions[1]"),
        ({"populations": [100_000], "iterations": 10_000}, "populations"),
        ({"seeds": list(range(600))}, "1,200 campaigns"),
        ({"catalogue": ["S9"]}, "catalogue[0]"),
    ],
)
def test_what_cannot_be_compared_is_refused_at_its_field(run: Run, changes: dict[str, Any], field: str) -> None:
    result = run("compare-optimizers", "-", stdin=json.dumps(SMALL | changes))
    assert result.exit_code == 2
    assert field in result.stderr
