import logging
from typing import Any

import psycopg
import pytest

from drivecal.storage.engine.failures import TRY_AGAIN_SECONDS, ServerLiveness, WatchedConnection


class FakeServer:
    """Answers, or does not; counts how often it was asked."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.answers = True
        self.asked = 0
        self.now = 0.0
        self.watch = ServerLiveness("the database", lambda: self.now)
        monkeypatch.setattr(WatchedConnection, "connect", self._connect)

    def _connect(self, *_: Any, **__: Any) -> WatchedConnection:
        self.asked += 1
        if not self.answers:
            raise psycopg.OperationalError("connection timeout expired\nand more")
        return WatchedConnection.__new__(WatchedConnection)

    def connects(self) -> bool:
        try:
            self.watch.connect("dsn")
        except psycopg.OperationalError:
            return False
        return True


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> FakeServer:
    return FakeServer(monkeypatch)


def test_only_one_caller_at_a_time_tries_a_server_that_was_silent(server: FakeServer) -> None:
    server.answers = False
    assert [server.connects() for _ in range(5)] == [False] * 5
    assert server.asked == 1
    server.now += TRY_AGAIN_SECONDS
    assert [server.connects() for _ in range(5)] == [False] * 5
    assert server.asked == 2


def test_who_tries_keeps_the_others_from_it_while_the_answer_is_out(server: FakeServer) -> None:
    server.watch.silent("nothing came")
    server.now += TRY_AGAIN_SECONDS
    others: list[bool] = []

    def connect(*_: Any, **__: Any) -> WatchedConnection:
        others.extend(server.connects() for _ in range(3))
        return WatchedConnection.__new__(WatchedConnection)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(WatchedConnection, "connect", connect)
        assert server.connects()
    assert others == [False] * 3


def test_once_it_answers_everybody_may_connect(server: FakeServer, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, "drivecal"):
        server.answers = False
        for _ in range(3):
            server.connects()
            server.now += TRY_AGAIN_SECONDS
        server.answers = True
        assert [server.connects() for _ in range(3)] == [True] * 3
    assert server.asked == 3 + 3
    down, up = caplog.messages
    assert down.startswith("the database the database does not answer (connection timeout expired)")
    assert up == "the database the database answers again"
