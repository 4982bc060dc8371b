from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from decimal import Decimal
from typing import Any

import pytest
from sqlalchemy import Connection
from tests.support.storage import SETUP, sample_sets

from drivecal.domain.parameters import ParameterSet
from drivecal.domain.setups import Setup
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets, setups


def test_sets_are_stored_once_and_ids_come_in_the_order_of_the_sets(connection: Connection) -> None:
    given = sample_sets(7000)  # more than one chunk of IN on SQLite
    few = parameter_sets.ensure(connection, given[100:200])
    ids = parameter_sets.ensure(connection, given)
    again = parameter_sets.ensure(connection, [*reversed(given), given[0]])
    assert ids[100:200] == few
    assert again == [*reversed(ids), ids[0]]
    assert len(set(ids)) == 7000
    assert parameter_sets.load(connection, ids) == dict(zip(ids, given, strict=True))
    assert parameter_sets.load(connection, [10**9]) == {}


def test_a_set_is_the_same_in_any_order_of_names_and_keeps_its_exact_decimals(connection: Connection) -> None:
    one = ParameterSet.of({"P1": Decimal("0.100000001"), "P2": Decimal("-999999.999999999")})
    turned = ParameterSet.of({"P2": Decimal("-999999.999999999"), "P1": Decimal("0.100000001")})
    ids = parameter_sets.ensure(connection, [one, turned])
    assert ids[0] == ids[1]
    assert parameter_sets.load(connection, ids) == {ids[0]: one}


def test_setups_are_stored_once_with_all_that_decides_their_runs(connection: Connection) -> None:
    other = Setup("S1", {**SETUP.document, "varied": {"mass": 1500.0000000000002}})
    ids = setups.ensure(connection, [SETUP, other, SETUP])
    assert setups.ensure(connection, [other]) == [ids[1]]
    counts = setups.counts(connection)
    assert ids[0] == ids[2] != ids[1]
    assert {each.fingerprint: each.document for each in counts} == {item.fingerprint: item.document for item in (SETUP, other)}
    assert [entry.runs for entry in counts] == [0, 0]


@pytest.mark.parametrize(
    ("ensure", "given"),
    [
        (parameter_sets.ensure, sample_sets(500)),
        (setups.ensure, [Setup(f"S{number}", {**SETUP.document, "scenario": f"S{number}"}) for number in range(6)]),
    ],
    ids=["sets", "setups"],
)
def test_threads_that_store_the_same_rows_get_the_same_ids(
    database: Database, ensure: Callable[[Connection, Sequence[Any]], list[int]], given: list[Any]
) -> None:
    def store(number: int) -> list[int]:
        with database.transaction() as connection:
            return ensure(connection, given if number % 2 else given[::-1])

    with ThreadPoolExecutor(8) as pool:
        results = list(pool.map(store, range(8)))
    assert {tuple(ids) if number % 2 else tuple(ids[::-1]) for number, ids in enumerate(results)} == {tuple(results[1])}
    assert len(set(results[1])) == len(given)
