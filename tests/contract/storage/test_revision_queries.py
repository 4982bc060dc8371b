"""Looks at campaigns that read little: they tell the same as reading everything."""

import pytest
from sqlalchemy import Connection
from tests.support.storage import campaign

from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import InvalidInputError, NotFoundError
from drivecal.storage import campaigns, processes, revision_queries
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now


def test_a_glance_tells_what_the_campaign_tells_and_when_the_dispatcher_was_heard_of(connection: Connection) -> None:
    stored = campaign(connection)
    campaigns.start(connection, stored.sequence)
    campaigns.degrade(connection, [stored.sequence], "no workers")
    campaigns.request_action(connection, stored.id, "pause")
    whole = campaigns.get(connection, stored.id)
    seen, heartbeat_at = revision_queries.campaign_revision(connection, stored.id)
    assert heartbeat_at is revision_queries.heartbeat(connection) is None
    for name in ("sequence", "id", "state", "requested_action", "revision", "degraded"):
        assert getattr(seen, name) == getattr(whole, name), name
    assert seen.state is CampaignState.RUNNING
    moment = now()
    processes.heartbeat(connection, "another", 1, moment, {})
    processes.heartbeat(connection, processes.DISPATCHER, 1, moment, {})
    _, heartbeat_at = revision_queries.campaign_revision(connection, stored.id)
    assert heartbeat_at == revision_queries.heartbeat(connection)
    assert heartbeat_at is not None
    assert heartbeat_at >= moment


@pytest.mark.parametrize("unknown", ["0" * 32, "", "\0", "\ud800", "0" * 10_000])
def test_there_is_nothing_to_see_of_what_is_not_there(database: Database, unknown: str) -> None:
    with database.read() as connection, pytest.raises(NotFoundError, check=lambda error: error.kind == "campaign"):
        revision_queries.campaign_revision(connection, unknown)


def test_a_page_of_glances_is_the_page_of_campaigns(connection: Connection) -> None:
    stored = [campaign(connection, str(number)) for number in range(5)]
    campaigns.insert(connection, name="single", spec={}, kind="evaluation")
    campaigns.start(connection, stored[1].sequence)
    first, cursor = campaigns.page(connection, limit=2)
    for state, at in ((None, None), (None, cursor), (CampaignState.RUNNING, None)):
        result, following = campaigns.page(connection, state=state, limit=2, cursor=at)
        seen = revision_queries.page(connection, state=state, limit=2, cursor=at)
        assert [item.id for item in seen[:2]] == [entry.id for entry in result]
        assert (len(seen) > 2) == (following is not None)
    with pytest.raises(InvalidInputError, check=lambda error: error.problems[0].field == "cursor"):
        revision_queries.page(connection, state=None, limit=2, cursor="nonsense")
    assert len(first) == 2


def test_a_revision_is_of_the_campaign_that_is_asked_for(connection: Connection) -> None:
    one, other = campaign(connection), campaign(connection)
    campaigns.start(connection, one.sequence)
    asked = (one.sequence, other.sequence, 10**6)
    assert [revision_queries.revision(connection, sequence) for sequence in asked] == [1, 0, None]
