"""What events say on the screen."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import pytest

from drivecal.cli.views.event_text import event_text
from drivecal.contracts.events import CampaignEvent
from drivecal.domain.events import EventKind

SILENT = {"queued", "running", "succeeded", "failed", "cancelled", "generation"}
"""What the progress and the end show as well."""
SAID: list[tuple[str, dict[str, Any], str]] = [
    ("stage", {"stage": "calibration", "cells": 120_000}, "the calibration stage begins: at most 120,000 cells"),
    ("phase", {"name": "intervals", "requested": 1234, "simulated": 1000}, "1,234 cells so far, 1,000 simulated"),
    ("influence_map", {"id": "ab", "influential": {"S1": ["P1", "P3"], "S2": []}}, "what matters is S1 P1 P3; S2 -"),
    ("best", {"objective": 5.5, "iteration": 2, "scores": {"S1": 6, "S2": 5}}, "new best 5.5000 in iteration 3: S1 6  S2 5"),
    ("baseline", {"objective": 5.25}, "the baseline has the objective 5.2500"),
    ("reuse_stopped", {"scenario": "S3", "wrong": 4, "audited": 20}, "reuse in S3 was stopped: 4 of 20 audited"),
    ("note", {"text": "S2 has weight 0"}, "note: S2 has weight 0"),
    ("degraded", {"reason": "no workers"}, "degraded: no workers"),
    ("pausing", {"state": "running"}, "asked to pause: what runs at workers is finished first"),
]


def said(kind: str, data: dict[str, Any]) -> str | None:
    return event_text(CampaignEvent(id=1, kind=kind, campaign="0" * 32, at=datetime(2026, 1, 1, tzinfo=UTC), data=data))


@pytest.mark.parametrize(("kind", "data", "text"), SAID)
def test_events_are_told_on_one_line(kind: str, data: dict[str, Any], text: str) -> None:
    line = said(kind, data)
    assert line is not None
    assert text in line
    assert "\n" not in line


@pytest.mark.parametrize("kind", [*EventKind, "of a newer server"])
def test_whatever_a_server_of_another_version_leaves_out_or_adds_something_is_said_or_nothing(kind: str) -> None:
    assert (said(kind, {}) is None) == (kind in SILENT or kind not in set(EventKind))
