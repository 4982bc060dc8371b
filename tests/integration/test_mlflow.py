"""A campaign as MLflow's file store: what MLflow reads, without MLflow."""

from pathlib import Path
from typing import Any

import yaml
from tests.support.command import command
from tests.support.runs import run, submit
from tests.support.server import serving

TINY: dict[str, Any] = {"optimizer": {"kind": "random", "population": 6, "iterations": 1, "seed": 1}}


def test_a_campaign_is_an_experiment_and_each_ranked_set_a_run_below_it(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'drivecal.db'}"
    with serving(url) as api:
        campaign = run(api.database, submit(api.database, **TINY))
        told = command("export", campaign.id, "--to", "mlflow", "-o", str(tmp_path / "mlruns"), "--url", api.url)
        assert told.exit_code == 0, told.output
        again = command("export", campaign.id, "--to", "mlflow", "-o", str(tmp_path / "mlruns"), "--url", api.url)
        assert again.exit_code == 0
    [experiment] = (tmp_path / "mlruns").iterdir()
    assert yaml.safe_load((experiment / "meta.yaml").read_text())["experiment_id"] == experiment.name
    runs = {path.parent.name: yaml.safe_load(path.read_text()) for path in experiment.glob("*/meta.yaml")}
    parents = [name for name in runs if not (experiment / name / "tags" / "mlflow.parentRunId").exists()]
    assert len(parents) == 1
    assert len(runs) > 5
    for name, meta in runs.items():
        assert (meta["run_id"], meta["status"], meta["lifecycle_stage"]) == (name, 3, "active")
        if name not in parents:
            assert (experiment / name / "tags" / "mlflow.parentRunId").read_text() == parents[0]
            moment, value, step = (experiment / name / "metrics" / "objective").read_text().split()
            assert (int(moment) > 0, float(value) >= 0, step) == (True, True, "0")
            assert {path.name for path in (experiment / name / "params").iterdir()} >= {"P1", "P11"}
