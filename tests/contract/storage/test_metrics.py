"""Metrics take as little place as their values, and keep every bit."""

from contextlib import suppress
from math import isfinite

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import select
from tests.support.databases import migrated

from drivecal.storage.engine import tables
from drivecal.storage.engine.database import Database
from drivecal.storage.references import metrics

NUMBERS = {"peak_mps2": 0.1 + 0.2, "offset_m": -0.0, "missing": float("nan")}
STORED = "hgqY8lRBl_bY:NDMzMzMz0z8AAAAAAAAAgAAAAAAAAPh/"


def test_the_stored_form_of_a_run_stays_as_it_is(database: Database) -> None:
    with database.transaction() as connection:
        assert metrics.pack(connection, [NUMBERS, NUMBERS]) == [STORED, STORED]
        assert connection.scalars(select(tables.metric_names.c.names)).all() == [list(NUMBERS)]


def test_every_bit_comes_back(tmp_path_factory: pytest.TempPathFactory) -> None:
    database = migrated(f"sqlite:///{tmp_path_factory.mktemp('metrics') / '1.db'}")

    @given(st.dictionaries(st.text(max_size=20), st.floats() | st.integers(-9, 9), max_size=8))
    def comes_back(given: dict[str, float]) -> None:
        with database.transaction() as connection:
            [stored] = metrics.pack(connection, [given])
            read = metrics.reader(connection)(stored)
        assert list(read) == list(given)
        assert [repr(value) for value in read.values()] == [
            repr(value) if isfinite(value) else "None" for value in given.values()
        ]

    comes_back()


def test_names_that_a_transaction_took_back_are_stored_by_the_next(database: Database) -> None:
    with suppress(ZeroDivisionError), database.transaction() as connection:
        [stored] = metrics.pack(connection, [NUMBERS])
        assert metrics.reader(connection)(stored)["offset_m"] == 0.0
        raise ZeroDivisionError
    with database.transaction() as connection:
        metrics.pack(connection, [NUMBERS])
        assert connection.scalars(select(tables.metric_names.c.names)).all() == [list(NUMBERS)]
