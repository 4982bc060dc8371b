"""Answers to an optimizer of the user's own."""

from types import SimpleNamespace
from typing import Any

import pytest

from drivecal.client.outside import AskTell
from drivecal.domain.errors import DrivecalError


class Failing:
    """A client whose campaign has failed."""

    def __init__(self) -> None:
        self.actions: list[str] = []

    def propose(self, _identifier: str, _sets: Any) -> Any:
        return SimpleNamespace(weights={"S1": 1.0})

    def answers(self, _identifier: str, **_: Any) -> Any:
        return SimpleNamespace(items=[], last=0, is_complete=True, state="failed", ended_by=None)

    def act(self, _identifier: str, action: str) -> None:
        self.actions.append(action)


def test_a_failed_campaign_ends_no_search_silently() -> None:
    client: Any = Failing()
    campaign: Any = SimpleNamespace(id="c1")
    with pytest.raises(DrivecalError) as caught, AskTell(client, campaign) as search:
        search.evaluate([{"gain": 1.0}])
    assert "c1" in str(caught.value)
    assert client.actions == []
