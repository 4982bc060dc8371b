"""Campaigns as files of MLflow's file store, which `mlflow ui` shows and `mlflow migrate-filestore` moves into a database of MLflow.

Needs no package of MLflow.

An experiment has the runs of a campaign: the campaign itself, and below it a run for each ranked set, with its parameters, its objective
and its scores. Written again, the same campaign has the same ids.
"""

import json
import re
from collections.abc import Mapping
from datetime import datetime
from hashlib import sha256
from pathlib import Path
from typing import Any

from drivecal.client.client import Client
from drivecal.contracts.campaign import Campaign
from drivecal.domain.errors import ConflictError

MOST_SETS = 1000
"""Ranked sets of a campaign that are written."""
_FINISHED, _FAILED, _KILLED = 3, 4, 5
"""Status numbers of MLflow."""
_STATUS = {"succeeded": _FINISHED, "failed": _FAILED, "cancelled": _KILLED}
_UNSUITED = re.compile(r"[^A-Za-z0-9_.\- /]")


def write_runs(client: Client, campaign_id: str, folder: Path) -> int:
    """Writes an ended campaign into a file store; returns the number of runs. Raises ConflictError before its end."""
    campaign = client.campaign(campaign_id)
    if campaign.ended_at is None or campaign.created_at is None:
        raise ConflictError(f"campaign {campaign.id} is {campaign.state}; export it when it has ended")
    solutions = client.solutions(campaign.id, limit=MOST_SETS).items
    experiment = folder / str(int(campaign.id[:15], 16))
    name = f"drivecal {campaign.name} {campaign.id[:8]}"
    times = _milliseconds(campaign.created_at), _milliseconds(campaign.ended_at)
    _write_meta(
        experiment,
        artifact_location=experiment.absolute().as_uri(),
        creation_time=times[0],
        experiment_id=experiment.name,
        last_update_time=times[1],
        lifecycle_stage="active",
        name=name,
    )
    parent = _run_id(campaign, 0)
    counts = {f"cells_{key}": float(value) for key, value in campaign.cells.model_dump().items() if isinstance(value, int)}
    best = {} if campaign.best is None else {"objective": campaign.best.objective}
    settings = {"problem": campaign.spec.get("problem"), **(campaign.spec.get("optimizer") or {}), **(campaign.budget or {})}
    tags = {"drivecal.campaign": campaign.id, "drivecal.owner": campaign.owner or "", "drivecal.tags": " ".join(campaign.tags)}
    _write_run(experiment, parent, campaign, campaign.name, settings, counts | best, tags)
    for solution in solutions:
        scores = {f"score_{name}": score for name, score in solution.scores.items() if score is not None}
        metrics = {name: getattr(solution, name) for name in ("objective", "rating", "rank", "violation")} | scores
        tags = {"mlflow.parentRunId": parent, "drivecal.copied": " ".join(solution.reused)}
        identifier, title = _run_id(campaign, solution.rank), f"rank {solution.rank}"
        _write_run(experiment, identifier, campaign, title, solution.parameters, metrics, tags)
    return 1 + len(solutions)


def _write_run(
    experiment: Path,
    run_id: str,
    campaign: Campaign,
    name: str,
    parameters: Mapping[str, Any],
    metrics: Mapping[str, float],
    tags: Mapping[str, str],
) -> None:
    run = experiment / run_id
    began, ended = (_milliseconds(moment) for moment in (campaign.started_at or campaign.created_at, campaign.ended_at))
    _write_meta(
        run,
        artifact_uri=(run / "artifacts").absolute().as_uri(),
        end_time=ended,
        entry_point_name="",
        experiment_id=experiment.name,
        lifecycle_stage="active",
        run_id=run_id,
        run_name=name,
        run_uuid=run_id,
        source_name="",
        source_type=4,
        source_version="",
        start_time=began,
        status=_STATUS.get(campaign.state, _FINISHED),
        tags=[],
        user_id=campaign.owner or "drivecal",
    )
    (run / "artifacts").mkdir(exist_ok=True)
    _write_values(run / "params", {key: str(value) for key, value in parameters.items() if value is not None})
    _write_values(run / "metrics", {key: f"{ended} {float(value)!r} 0\n" for key, value in metrics.items()})
    _write_values(run / "tags", {"mlflow.runName": name, **{key: value for key, value in tags.items() if value}})


def _write_meta(folder: Path, **values: object) -> None:
    """Writes `meta.yaml` of an experiment or a run; JSON strings are YAML."""
    folder.mkdir(parents=True, exist_ok=True)
    text = "".join(f"{name}: {json.dumps(value, ensure_ascii=False)}\n" for name, value in values.items())
    (folder / "meta.yaml").write_text(text, encoding="utf-8")


def _write_values(folder: Path, values: Mapping[str, str]) -> None:
    folder.mkdir(exist_ok=True)
    for name, text in values.items():
        (folder / _UNSUITED.sub("_", name)).write_text(text, encoding="utf-8")


def _run_id(campaign: Campaign, rank: int) -> str:
    return sha256(f"{campaign.id} {rank}".encode()).hexdigest()[:32]


def _milliseconds(moment: datetime | None) -> int:
    return 0 if moment is None else round(1000 * moment.timestamp())
