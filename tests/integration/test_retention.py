"""`drivecal db prune`."""

import json
from datetime import timedelta

from tests.support.problems import MANIFEST, store
from tests.support.pruning import SPACE, set_column
from tests.support.runs import get, run, submit
from typer.testing import CliRunner

from drivecal.cli.main import app
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now


def test_the_command_lists_what_goes_and_changes_nothing_in_a_dry_run(database: Database) -> None:
    search = {"kind": "genetic", "population": 8, "iterations": 2, "seed": 1}
    old = run(database, submit(database, parameters=SPACE, catalogue=["S1"], optimizer=search))
    set_column(database, old, "ended_at", (now() - timedelta(days=200)).strftime("%Y-%m-%d %H:%M:%S.%f"))
    old = get(database, old)
    url = database.url.render_as_string(hide_password=False)
    command = ["db", "prune", "--older", "90d", "--database-url", url, "--json"]
    dry = json.loads(CliRunner().invoke(app, [*command, "--dry-run"]).stdout)
    assert dry["cells"] > 0
    assert [listed["id"] for listed in dry["campaigns"]] == [old.id]
    assert get(database, old) == old
    assert CliRunner().invoke(app, [*command, "--problem", "another"]).exit_code != 0
    store(database, MANIFEST | {"problem": "another"})
    other = json.loads(CliRunner().invoke(app, [*command, "--problem", "another"]).stdout)
    assert other["campaigns"] == []
    wet = json.loads(CliRunner().invoke(app, command).stdout)
    assert wet | {"dry_run": True} == dry
    assert json.loads(CliRunner().invoke(app, command).stdout)["cells"] == 0
    assert CliRunner().invoke(app, ["db", "prune", "--older", "soon"]).exit_code == 2
