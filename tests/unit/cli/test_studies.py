"""Known studies: which campaign's results a command takes."""

from types import SimpleNamespace
from typing import cast

import pytest

from drivecal.cli.commands import studies
from drivecal.cli.commands.studies import known, wanted_of
from drivecal.client.client import Client
from drivecal.contracts.campaign import Campaign, Study, StudyPage


def study() -> Study:
    """A finished study of robustness."""
    settings = {"condition": "max", "eta": 1.0, "delta": 0.1, "steps": 2, "samples": 4}
    return Study(
        campaign="0" * 32, name="study", stage="robustness", state="succeeded", settings=settings, vehicle=None, ended_at=None
    )


def client(*listed: Study, campaign: Campaign | None = None) -> Client:
    """A client that lists these studies of any campaign, and knows one campaign."""
    return cast("Client", SimpleNamespace(studies=lambda _: StudyPage(items=list(listed)), campaign=lambda _: campaign))


def test_a_study_that_is_being_made_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = Campaign(id="0" * 32, name="searched", state="succeeded")
    maker = Campaign(id="1" * 32, name="study", state="running", spec={"robustness": {"delta": 0.1}})

    made = study().model_copy(update={"campaign": maker.id, "state": "running"})
    ended = maker.model_copy(update={"state": "succeeded"})
    monkeypatch.setattr(studies, "follow", lambda _, identifier: ended if identifier == maker.id else None)
    assert known(client(made, campaign=maker), campaign, wanted_of(campaign, "robustness", {"delta": 0.1})) is ended


@pytest.mark.parametrize(("state", "done"), [("succeeded", True), ("cancelled", False), ("failed", False), ("running", False)])
def test_only_a_study_that_succeeded_is_known(state: str, done: bool) -> None:
    campaign = Campaign(id="0" * 32, name="study", state=state, spec={"robustness": {"delta": 0.1}})
    listed = study().model_copy(update={"campaign": campaign.id, "state": state})
    maker = known(client(listed), campaign, wanted_of(campaign, "robustness", {"delta": 0.1}))
    assert (maker is campaign) == done
