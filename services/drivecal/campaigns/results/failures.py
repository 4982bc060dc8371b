"""Causes of failed cells: why runs have no result or took a second attempt, which failures simulations report, why scores have no value."""

import re
from collections.abc import Iterable

from sqlalchemy import Connection

from drivecal.analysis.scoring import rate
from drivecal.bundles.expressions import Formula
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.resolve.workbench import bundles_of
from drivecal.contracts.evaluation import FailureCause
from drivecal.domain.evaluations import Outcome
from drivecal.storage import evaluations
from drivecal.storage.campaigns import StoredCampaign

MOST_GROUPS = 10_000
"""Groups of equal words, and runs with the worst score, that are looked at."""
MOST_CAUSES = 100
_VARYING = re.compile(r"/\S*drivecal-\S+|0x[0-9a-fA-F]+|\d+(\.\d+)?([eE][-+]?\d+)?")


def causes_of(connection: Connection, campaign: StoredCampaign) -> list[FailureCause]:
    """Returns the causes of a campaign's failed cells, frequent ones first."""
    return _merged([*_reported(connection, campaign.sequence), *_undefined(connection, campaign)])[:MOST_CAUSES]


def broken_down(connection: Connection, campaign_sequence: int) -> list[FailureCause]:
    """Returns the causes of cells without a result, frequent ones first."""
    return _merged(cause for cause in _reported(connection, campaign_sequence) if cause.kind == "no_result")


def _reported(connection: Connection, campaign_sequence: int) -> list[FailureCause]:
    causes = []
    for group in evaluations.failed_cells(connection, campaign_sequence, MOST_GROUPS):
        known = {"scenarios": [group.scenario], "cells": group.cells, "example": group.example}
        if group.outcome is Outcome.FAILED:
            causes.append(FailureCause(kind="no_result", cause=group.failure or "", detail=group.detail, **known))
            continue
        if group.failure is not None:
            causes.append(FailureCause(kind="failed", cause=group.failure, **known))
        if group.detail is not None:
            breakdown, _, detail = group.detail.partition(": ")
            causes.append(FailureCause(kind="retried", cause=breakdown, detail=detail, **known))
    return causes


def _undefined(connection: Connection, campaign: StoredCampaign) -> list[FailureCause]:
    """Rates runs again, because only the formulas know which of them have no value: if the campaign has no other score among its goals,
    runs with the worth of a failed run alone."""
    if campaign.resolution is None or not any(cells.get("unscored") for cells in campaign.stages.values()):
        return []
    resolved = resolved_spec(campaign)
    own, others = resolved.scale, resolved.goals.computed.values()
    texts = [(own, bundles_of(connection)(campaign.spec["problem"]).manifest.scores[own.name].formula)]
    texts += [(value.scale, value.formula) for value in others if value.scale is not None]
    formulas = [(scale, Formula(text)) for scale, text in texts if text is not None]
    causes = []
    for run in evaluations.scored(connection, campaign.sequence, None if len(texts) > 1 else own.failed, MOST_GROUPS):
        known = {name: value for name, value in run.metrics.items() if value is not None}
        ratings = (rate(formula, scale, known, None) for scale, formula in formulas)
        cause = next((each.undefined for each in ratings if each is not None and each.undefined is not None), None)
        if cause is not None:
            place = {"scenarios": [run.scenario], "cells": run.cells, "example": run.example}
            causes.append(FailureCause(kind="unscored", cause=cause, **place))
    return causes


def _merged(causes: Iterable[FailureCause]) -> list[FailureCause]:
    """Joins causes whose words differ in numbers and temporary paths only; returns frequent ones first."""
    merged: dict[tuple[str, str, str | None], FailureCause] = {}
    for cause in sorted(causes, key=lambda cause: cause.example):
        key = (cause.kind, _plain(cause.cause) or "", _plain(cause.detail))
        first = merged.get(key)
        if first is None:
            merged[key] = cause
        else:
            scenarios = list(dict.fromkeys([*first.scenarios, *cause.scenarios]))
            merged[key] = first.model_copy(update={"cells": first.cells + cause.cells, "scenarios": scenarios})
    return sorted(merged.values(), key=lambda cause: (-cause.cells, cause.example))


def _plain(words: str | None) -> str | None:
    return None if words is None else _VARYING.sub("#", words)
