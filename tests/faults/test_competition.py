"""Many at once: fifty clients with one key, and two servers on one database."""

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psycopg
import pytest
from sqlalchemy import func, make_url, select
from tests.support.faults.coordinator import READY_SECONDS, Coordinator, coordinator, suspended
from tests.support.faults.findings import Found
from tests.support.faults.lives import PATIENCE_SECONDS, Life, Moment, assert_as_without_faults, live, wait_until_ended
from tests.support.faults.workload import ANALYSING, post, submit
from tests.support.serve import alive

from drivecal.storage.engine.tables import campaigns

CLIENTS = 50
MakeServer = Callable[[str], Coordinator]
pytestmark = [pytest.mark.faults, pytest.mark.timeout(3600)]


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_fifty_posts_with_one_key_make_one_campaign_though_the_api_is_killed(kind: str, server_on: MakeServer) -> None:
    server = server_on(kind)
    server.start_ready()
    for attempt in range(5):
        key, together = f"key-{attempt}", threading.Barrier(CLIENTS + 1)

        def one_client(key: str = key, together: threading.Barrier = together) -> str:
            together.wait()
            return post(server.url, "/api/v1/campaigns", ANALYSING, key)

        with ThreadPoolExecutor(CLIENTS) as pool:
            posted = [pool.submit(one_client) for _ in range(CLIENTS)]
            together.wait()
            time.sleep(0.05 * attempt)
            server.api().kill()
            identifiers = {item.result() for item in posted}
        assert len(identifiers) == 1
        with server.database.read() as connection:
            query = select(func.count()).select_from(campaigns).where(campaigns.c.idempotency_key == key)
            assert connection.execute(query).scalar_one() == 1
        with pytest.raises(AssertionError, match=r"^409 "):  # the same key with another body
            post(server.url, "/api/v1/campaigns", {}, key)
    server.terminate()


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_second_server_is_refused(kind: str, server_on: MakeServer, without_faults: dict[str, Found], tmp_path: Path) -> None:
    server = server_on(kind)

    def second_server(first: Coordinator) -> None:
        with suspended([first.dispatcher()]), coordinator(tmp_path / "second", first.database_url) as second:
            second.start()
            second.until(lambda: not second.running, "the end of the second server", READY_SECONDS)
            assert "another drivecal server" in second.told()
            time.sleep(10.0)

    live(server, [(Moment(0.4, 0.0), second_server)], without_faults)


def test_a_superseded_dispatcher_does_nothing(server_on: MakeServer, without_faults: dict[str, Found], tmp_path: Path) -> None:
    first = server_on("postgresql")
    first.start_ready()
    accepted = submit(first.url)
    life = Life(first, sum(len(fault.tables["evaluations"]) for fault in without_faults.values()))
    life.wait_for(Moment(0.3, 0.0), accepted)
    with coordinator(tmp_path / "second", first.database_url) as second:
        sleeper = first.dispatcher()
        with suspended([sleeper]):
            _lose_the_lock(first.database_url)  # as when a firewall forgets the connection of a machine that sleeps
            second.start_ready()
            life.tell(f"another server has taken over at {life.answered(accepted)} cells")
        first.until(lambda: not alive(sleeper), "the end of the superseded dispatcher", READY_SECONDS)
        life.tell("the superseded dispatcher has ended")
        wait_until_ended(second, accepted, PATIENCE_SECONDS)
        assert_as_without_faults(second, accepted, without_faults)
        print(first.told()[-2000:])
        first.terminate()
        second.terminate()


def _lose_the_lock(database_url: str) -> None:
    url = make_url(database_url).set(drivername="postgresql").render_as_string(hide_password=False)
    with psycopg.connect(url, autocommit=True) as connection:
        ended = connection.execute(
            "SELECT count(pg_terminate_backend(pid)) FROM pg_locks WHERE locktype = 'advisory' AND granted"
            " AND database = (SELECT oid FROM pg_database WHERE datname = current_database())"
        ).fetchone()
    assert ended == (1,)
