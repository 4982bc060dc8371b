"""Documented promises contain the numbers of the code."""

from pathlib import Path

from drivecal.api.http.protocol import MOST_CONNECTIONS
from drivecal.api.live.streams import KEEPALIVE_SECONDS
from drivecal.configuration.settings import Settings
from drivecal.contracts.specification import ReductionSpecification
from drivecal.execution.scheduling.batching import BatchPolicy, batch_size
from drivecal.execution.scheduling.in_flight import WITNESSES
from drivecal.execution.scheduling.refusals import PATIENCE_WITH_REFUSALS
from drivecal.execution.scheduling.reservation import LONG_SECONDS, SMALL_SECONDS
from drivecal.execution.scheduling.scheduler import ATTEMPTS, MOST_LOSSES
from drivecal.storage.admission import MOST_MAPS
from drivecal.storage.engine.database import PROMPT

PROMISES = (Path(__file__).parents[2] / "docs" / "pages" / "concepts" / "guarantees.md").read_text(encoding="utf-8")
LIMITS = {name: field.default for name, field in Settings.model_fields.items()}


def test_numbers_in_promises_are_those_of_the_code() -> None:
    for text, promised, actual in (
        ("up to 20 (`reduction.confirm`", 20, ReductionSpecification().confirm),
        ("memory three times", 3, ATTEMPTS),
        ("loses ten workers", 10, MOST_LOSSES),
        ("if two workers", 2, WITNESSES),
        ("after half a minute", 30.0, PATIENCE_WITH_REFUSALS),
        ("each of 0.5 s", 0.5, BatchPolicy().target_seconds),
        ("at most 2 s of its work", 2.0, SMALL_SECONDS),
        ("cells above 5 s", 5.0, LONG_SECONDS),
        ("At most eight campaigns", 8, LIMITS["running_campaigns"]),
        ("problems: 64 MB", 64, LIMITS["problem_mb"]),
        ("over 10,000,000 cells", 10_000_000, LIMITS["largest_campaign"]),
        ("more than 1,000 posted influence maps", 1_000, MOST_MAPS),
        ("or pushed problems", 1_000, LIMITS["pushed_problems"]),
        ("More than 1,000 queued", 1_000, LIMITS["queued_campaigns"]),
        ("or 100 event streams", 100, LIMITS["event_streams"]),
        ("more than 500 requests", 500, MOST_CONNECTIONS),
        ("end within 15 s", 15.0, KEEPALIVE_SECONDS),
    ):
        assert text in PROMISES, text
        assert actual == promised, text


def test_batches_beside_a_small_campaign_are_as_short_as_promised() -> None:
    assert "0.1 s with up to six workers, 0.13 s with eight, 0.5 s with 32" in PROMISES
    cost = 0.001  # of a cell: small enough that no other limit counts
    policy = BatchPolicy(largest=10_000)
    for workers, seconds in ((1, 0.1), (6, 0.1), (8, 0.13), (32, 0.5)):
        assert round(batch_size(policy, cost, 1e6, workers, beside_small=True) * cost, 2) == seconds


def test_the_api_gives_up_on_a_database_before_it_has_to_say_so() -> None:
    assert "reports the trouble within five seconds" in PROMISES
    assert max(PROMPT.lock, PROMPT.connect) < 5.0
