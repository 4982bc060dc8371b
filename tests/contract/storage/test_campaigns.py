from dataclasses import replace
from datetime import timedelta
from typing import get_args

import pytest
from sqlalchemy import Connection, update
from tests.support.storage import campaign, new_run, sample_set_ids, setup_id

from drivecal.api.responses import campaign_answer
from drivecal.contracts.campaign import Baseline, Best, CellCounts, ErrorRate, Progress
from drivecal.domain.campaigns import Action, CampaignState, StageName
from drivecal.domain.errors import ConflictError, NotFoundError
from drivecal.storage import campaigns
from drivecal.storage.campaigns import CampaignHeading, StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.tables import campaigns as table
from drivecal.storage.engine.types import now
from drivecal.storage.references import runs
from drivecal.storage.revision_queries import campaign_revision

QUEUED, RUNNING, PAUSED = CampaignState.QUEUED, CampaignState.RUNNING, CampaignState.PAUSED
CANCELLING, CANCELLED, SUCCEEDED = CampaignState.CANCELLING, CampaignState.CANCELLED, CampaignState.SUCCEEDED


@pytest.mark.parametrize("unknown", ["0" * 32, "", "x", "\0", "\ud800", "' OR 1=1", "0" * 10_000])
def test_a_campaign_that_is_not_there_is_not_found_whatever_is_asked_for(database: Database, unknown: str) -> None:
    with database.transaction() as connection:
        campaign(connection)
        with pytest.raises(NotFoundError, check=lambda error: error.kind == "campaign"):
            campaigns.get(connection, unknown)
        with pytest.raises(NotFoundError, check=lambda error: error.kind == "campaign"):
            campaigns.request_action(connection, unknown, "cancel")
    with database.read() as connection, pytest.raises(NotFoundError):
        campaigns.by_sequence(connection, 10**6)


def test_first_characters_of_an_id_are_enough_if_no_other_begins_so(connection: Connection) -> None:
    first, other = (campaigns.insert(connection, name="mine", spec={}).sequence for _ in range(2))
    single = campaigns.insert(connection, name="single", spec={}, kind="evaluation").sequence
    for sequence, beginning in ((first, "5050a"), (other, "5050b"), (single, "5051")):
        named = update(table).where(table.c.sequence == sequence)
        connection.execute(named.values(id=beginning.ljust(32, "f")))
    assert campaigns.get(connection, "5050a").sequence == first
    assert campaign_revision(connection, "5050bf")[0].sequence == other
    for unclear in ("5050", "505", "5051"):
        with pytest.raises(NotFoundError):
            campaigns.get(connection, unclear)


def test_the_list_is_newest_first_and_pages_are_complete_whatever_comes_in_between(connection: Connection) -> None:
    for number in range(5):
        campaign(connection, str(number))
    campaigns.insert(connection, name="single", spec={}, kind="evaluation")
    first, cursor = campaigns.page(connection, limit=2)
    campaign(connection, "newer")
    second, cursor = campaigns.page(connection, limit=2, cursor=cursor)
    third, last = campaigns.page(connection, limit=2, cursor=cursor)
    assert [[item.name for item in page] for page in (first, second, third)] == [["4", "3"], ["2", "1"], ["0"]]
    assert last is None


def test_neither_lists_nor_the_dispatchers_look_carry_long_specifications(connection: Connection) -> None:
    long = {"optimizer": {"start_sets": [{"P1": number / 10} for number in range(2000)]}}
    stored = campaigns.insert(connection, name="long", spec=long)
    short = campaigns.insert(connection, name="short", spec={"name": "short"})
    listed, _ = campaigns.page(connection)
    assert [item.spec for item in listed] == [{"name": "short"}, {}]
    assert campaigns.get(connection, stored.id).spec == long
    assert [(type(entry), entry.id) for entry in campaigns.active(connection)] == [
        (CampaignHeading, stored.id),
        (CampaignHeading, short.id),
    ]


def test_a_started_campaign_sees_what_was_stored_until_then(connection: Connection) -> None:
    queued = campaign(connection)
    (set_id,) = sample_set_ids(connection, 1)
    runs.insert_results(connection, [new_run(setup_id(connection), set_id)])
    started = campaigns.start(connection, queued.sequence)
    assert started is not None
    assert started.state is RUNNING
    assert started.watermark == runs.largest_id(connection) == 1
    assert started.started_at is not None
    assert campaigns.start(connection, queued.sequence) is None, "it is queued no more"


def test_progress_is_written_and_read_back_whole(connection: Connection) -> None:
    cells = {
        StageName.CALIBRATION: CellCounts(proposed=10, pending=4, requested=6, simulated=6, audited=1),
        StageName.SENSITIVITY: CellCounts(requested=3, simulated=3),
    }
    queued = campaign(connection)
    progressed = replace(
        queued,
        stage=StageName.CALIBRATION,
        iteration=3,
        progress=Progress(done=6, total=10, eta_seconds=1.5),
        error_rate={"S1": ErrorRate(audited=1, upper_95=0.975)},
        best=Best(objective=5.67, parameters={"P1": 0.5}, scores={"S1": 6}, alternatives=2),
        baseline=Baseline(objective=None, parameters={"P1": 0.25}, scores={"S1": None}),
        simulating_seconds=12.5,
        notes=("S2 has weight 0",),
    )
    campaigns.save_progress(connection, progressed, cells)
    stored = campaigns.by_sequence(connection, queued.sequence)
    assert stored == replace(progressed, revision=stored.revision, stages=stored.stages)
    assert {stage: stored.counts(stage) for stage in stored.stages} == cells


def test_a_campaign_that_rests_or_has_ended_waits_for_nothing_any_more(connection: Connection) -> None:
    paused, ended, cancelled = (campaign(connection) for _ in range(3))
    campaigns.explain(connection, {each.sequence: "place 2 of 2" for each in (ended, cancelled)})
    assert campaigns.get(connection, ended.id).waiting is not None
    assert campaigns.request_action(connection, cancelled.id, "cancel").waiting is None
    for item in (paused, ended):
        campaigns.start(connection, item.sequence)
    campaigns.degrade(connection, [paused.sequence, ended.sequence], "no workers")
    campaigns.request_action(connection, paused.id, "pause")
    assert campaigns.carry_out(connection, paused.sequence, "pause")
    assert campaigns.end(connection, ended.sequence, SUCCEEDED)
    assert [campaigns.get(connection, entry.id).degraded for entry in (paused, ended)] == [None, None]
    assert campaigns.get(connection, ended.id).waiting is None


def test_a_request_that_was_withdrawn_or_replaced_is_not_carried_out(connection: Connection) -> None:
    withdrawn: tuple[tuple[Action, Action], ...] = (("pause", "resume"), ("resume", "pause"))
    stored = campaign(connection)
    assert not campaigns.carry_out(connection, stored.sequence, "pause")
    campaigns.start(connection, stored.sequence)
    for ask, taken_back in withdrawn:
        campaigns.request_action(connection, stored.id, ask)
        state = campaigns.request_action(connection, stored.id, taken_back).state
        assert not campaigns.carry_out(connection, stored.sequence, ask)
        assert campaigns.by_sequence(connection, stored.sequence).state is state
        campaigns.request_action(connection, stored.id, ask)
        assert campaigns.carry_out(connection, stored.sequence, ask)
        assert campaigns.by_sequence(connection, stored.sequence).requested_action is None
    campaigns.request_action(connection, stored.id, "pause")
    campaigns.request_action(connection, stored.id, "cancel")
    assert not campaigns.carry_out(connection, stored.sequence, "pause")
    assert campaigns.carry_out(connection, stored.sequence, "cancel")
    assert campaigns.by_sequence(connection, stored.sequence).state is CANCELLING


def test_a_campaign_that_is_asked_to_cancel_is_listed_as_cancelling(connection: Connection) -> None:
    running, asked, ended = (campaign(connection) for _ in range(3))
    for stored in (running, asked, ended):
        campaigns.start(connection, stored.sequence)
    campaigns.request_action(connection, asked.id, "cancel")
    campaigns.request_action(connection, ended.id, "cancel")
    campaigns.end(connection, ended.sequence, SUCCEEDED)
    listed = {state: [stored.id for stored in campaigns.page(connection, state=state)[0]] for state in CampaignState}
    kept = {state: found for state, found in listed.items() if found}
    assert kept == {RUNNING: [running.id], CANCELLING: [asked.id], SUCCEEDED: [ended.id]}


def put(connection: Connection, stored: StoredCampaign, state: CampaignState) -> None:
    if state.ended:
        campaigns.end(connection, stored.sequence, state)
    else:
        connection.execute(update(table).where(table.c.sequence == stored.sequence).values(state=state))


REQUESTS: list[tuple[CampaignState, bool, Action, CampaignState, Action | None]] = [
    # state, started, request -> state, requested action
    (QUEUED, False, "cancel", CANCELLED, None),
    (QUEUED, False, "pause", PAUSED, None),
    (QUEUED, False, "resume", QUEUED, None),
    (RUNNING, True, "cancel", RUNNING, "cancel"),
    (RUNNING, True, "pause", RUNNING, "pause"),
    (RUNNING, True, "resume", RUNNING, None),
    (PAUSED, False, "cancel", CANCELLED, None),
    (PAUSED, False, "pause", PAUSED, None),
    (PAUSED, False, "resume", QUEUED, None),
    (PAUSED, True, "cancel", PAUSED, "cancel"),  # the dispatcher stores the best of all its answers first
    (PAUSED, True, "pause", PAUSED, None),
    (PAUSED, True, "resume", PAUSED, "resume"),
    (CANCELLING, True, "cancel", CANCELLING, None),
    (CANCELLED, True, "cancel", CANCELLED, None),
]


@pytest.mark.parametrize(("state", "started", "action", "expected", "asked"), REQUESTS)
def test_a_request_is_executed_at_once_where_nothing_runs_and_left_to_the_dispatcher_where_something_does(
    connection: Connection,
    state: CampaignState,
    *,
    started: bool,
    action: Action,
    expected: CampaignState,
    asked: Action | None,
) -> None:
    stored = campaign(connection)
    if started:
        campaigns.start(connection, stored.sequence)
    put(connection, stored, state)
    for _ in range(2):  # idempotent
        after = campaigns.request_action(connection, stored.id, action)
        assert (after.state, after.requested_action) == (expected, asked)
    assert (after.ended_at is not None) == expected.ended


@pytest.mark.parametrize(
    ("state", "actions"), [(SUCCEEDED, get_args(Action)), (CANCELLED, ("pause", "resume")), (CANCELLING, ("pause", "resume"))]
)
def test_a_request_that_comes_too_late_is_a_conflict(
    connection: Connection, state: CampaignState, actions: tuple[Action]
) -> None:
    stored = campaign(connection)
    campaigns.start(connection, stored.sequence)
    put(connection, stored, state)
    for action in actions:
        with pytest.raises(ConflictError, match=action):
            campaigns.request_action(connection, stored.id, action)


def test_a_campaign_never_shows_a_negative_time(connection: Connection) -> None:
    sequence = campaign(connection).sequence
    campaigns.start(connection, sequence)
    running = campaigns.by_sequence(connection, sequence)
    assert campaign_answer(running, now() - timedelta(hours=1), silent=None).seconds.wall == 0.0
    assert campaign_answer(running, now() + timedelta(hours=1), silent=None).seconds.wall >= 3600.0


def test_an_isolated_campaign_spends_its_budget_on_runs_of_others_too(connection: Connection) -> None:
    stages = {StageName.CALIBRATION: {"requested": 9, "simulated": 9, "runs": 6, "lost": 1, "shared": 4}}
    for isolated, simulations, stored in ((True, 9, 4), (False, 5, 0)):
        known = campaign(connection)
        known = replace(known, spec=dict(known.spec) | {"reduction": {"isolated": isolated}}, stages=stages)
        spent = campaign_answer(known, now(), silent=None).spent
        assert (spent.simulations, spent.stored) == (simulations, stored)
