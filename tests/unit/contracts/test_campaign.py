"""The answers about campaigns hold the fields that the interface promises."""

from drivecal.contracts.campaign import Campaign, CellCounts, ErrorRate
from drivecal.domain.evaluations import Outcome


def test_a_campaign_has_every_field_of_the_interface() -> None:
    promised = {
        "id", "name", "state", "degraded", "stage", "progress", "cells", "sensitivity_cells", "error_rate", "best", "seconds",
        "error", "spec", "links",
    }  # fmt: skip
    shown = Campaign(id="1", name="n", state="queued").model_dump(mode="json")
    assert promised <= set(shown)
    assert shown["progress"] == {"done": 0, "total": 0, "eta_seconds": None}
    assert shown["seconds"] == {"wall": 0.0, "simulating": 0.0}


def test_cells_are_counted_under_the_names_of_the_interface() -> None:
    assert set(CellCounts.model_fields) >= {
        "proposed", "carried_over", "pending", "requested", "repeated", "reused", "predicted", "certified", "simulated", "failed",
        "audited", "sampled",
    }  # fmt: skip
    assert CellCounts.model_fields.keys() >= {outcome.value for outcome in Outcome}
    assert set(ErrorRate.model_fields) >= {"audited", "different", "wrong", "upper_95", "stopped"}


def test_a_client_reads_answers_of_a_newer_server() -> None:
    result = Campaign.model_validate({"id": "1", "name": "n", "state": "running", "new_field": {"x": 1}})
    assert result.state == "running"
