"""Texts of events."""

from typing import Any

import pytest

from drivecal.domain.events import EventKind, event_text

FIGURES: list[tuple[EventKind, dict[str, Any], list[str]]] = [
    (EventKind.STAGE, {"stage": "calibration", "cells": 120_000}, ["calibration", "120,000"]),
    (EventKind.PHASE, {"name": "intervals", "requested": 1234, "simulated": 1000}, ["intervals", "1,234", "1,000"]),
    (EventKind.INFLUENCE_MAP, {"id": "ab", "influential": {"S1": ["P1", "P3"], "S2": []}}, ["ab", "S1 P1 P3", "S2 -"]),
    (EventKind.GENERATION, {"iteration": 0, "best": 5, "mean": 4.25}, ["1", "5.0000", "4.2500"]),
    (
        EventKind.BEST,
        {"objective": 5.5, "iteration": 2, "scores": {"S1": 6, "S2": 5}},
        ["5.5000", "iteration 3", "S1 6", "S2 5"],
    ),
    (EventKind.BASELINE, {"objective": 0.0000525}, ["5.25e-05"]),
    (EventKind.LOT_REJECTED, {"scenario": "S3", "wrong": 4, "audited": 20}, ["S3", "4", "20"]),
    (EventKind.NOTE, {"text": "S2 has weight 0"}, ["S2 has weight 0"]),
    (EventKind.DEGRADED, {"reason": "no workers"}, ["no workers"]),
    (EventKind.FAILED, {"error": "no map"}, ["no map"]),
]


@pytest.mark.parametrize(("kind", "data", "figures"), FIGURES)
def test_the_text_of_an_event_holds_its_figures(kind: EventKind, data: dict[str, Any], figures: list[str]) -> None:
    text = event_text(kind, data)
    assert [figure for figure in figures if figure not in text] == []
    assert "\n" not in text


@pytest.mark.parametrize("kind", [*EventKind, "something_new"])
def test_every_kind_has_a_text_even_without_data_or_of_another_version(kind: str) -> None:
    assert event_text(kind, {})


def test_data_of_another_version_cannot_break_a_stream() -> None:
    odd = {
        "cells": "many",
        "stage": 7,
        "iteration": "x",
        "influential": [],
        "scores": 3,
        "best": {},
        "mean": [],
        "objective": "5",
    }
    assert all(event_text(kind, odd) for kind in EventKind)


def test_a_line_shows_scores_with_six_digits() -> None:
    best = {"objective": 1.0, "iteration": 0, "scores": {"town": 59.740123456789, "road": 6}, "violation": 0.0}
    text = event_text(EventKind.BEST, best)
    assert ("2.0 %" in text, "2.0 %" in event_text(EventKind.BEST, best | {"violation": 0.02})) == (False, True)
    assert "%" not in event_text(EventKind.BEST, best | {"violation": 0.0002, "undecided": True})
    assert text.endswith("town 59.7401  road 6")
    assert event_text(EventKind.GENERATION, {"iteration": 0, "best": 1.0, "mean": None}).endswith(" 1.0000")
