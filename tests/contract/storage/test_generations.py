import pytest
from sqlalchemy import Connection, select
from tests.support.storage import campaign
from tests.support.values import present

from drivecal.contracts.tables import Generation
from drivecal.domain.errors import InvalidInputError
from drivecal.storage import generations
from drivecal.storage.engine import tables

FOUND = {
    "requested": 3,
    "repeated": 1,
    "simulated": 2,
    "audited": 1,
    "best": 6.5,
    "mean": 4.25,
    "minimum": 0.0,
    "alternatives": 2,
}


def asked(iteration: int = 0, **found: float) -> Generation:
    return Generation(iteration=iteration, **{"proposed": 4, "carried_over": 1} | found)


def test_a_generation_is_taken_up_as_it_was_asked_for(connection: Connection) -> None:
    sequence = campaign(connection).sequence
    assert generations.last(connection, sequence) is None
    assert generations.course(connection, sequence) == []
    generations.insert(
        connection,
        sequence,
        asked(),
        population=[[1, 2], [3, 4]],
        changed=[True, False],
        optimizer_state={"bits": "0110", "generator": {"state": 2**127 + 1}},
    )
    stored = present(generations.last(connection, sequence))
    assert (stored.iteration, stored.figures, stored.finished, stored.objectives) == (0, asked(), False, None)
    assert (stored.population, stored.changed) == ([[1, 2], [3, 4]], [True, False])
    assert stored.optimizer_state == {"bits": "0110", "generator": {"state": 2**127 + 1}}


def test_a_finished_generation_keeps_what_it_found(connection: Connection) -> None:
    sequence = campaign(connection).sequence
    for iteration in range(2):
        generations.insert(connection, sequence, asked(iteration), population=[[0]], changed=[True], optimizer_state={})
        generations.finish(connection, sequence, asked(iteration, **FOUND), [6.5, float("nan"), None])
    stored = present(generations.last(connection, sequence))
    known = [asked(0, **FOUND), asked(1, **FOUND)]
    assert generations.page(connection, sequence) == (known, None)
    assert generations.course(connection, sequence) == known
    assert (stored.iteration, stored.figures, stored.finished) == (1, known[1], True)
    assert stored.objectives == [6.5, None, None]


def test_figures_that_are_no_numbers_are_null(connection: Connection) -> None:
    sequence = campaign(connection).sequence
    generations.insert(connection, sequence, asked(), population=[], changed=[], optimizer_state={})
    generations.finish(connection, sequence, asked(best=float("nan"), mean=float("-inf")), [])
    (figures,), _ = generations.page(connection, sequence)
    assert (figures.best, figures.mean, figures.minimum) == (None, None, None)


def test_only_the_newest_generation_keeps_the_optimizers_state(connection: Connection) -> None:
    sequence, other = campaign(connection).sequence, campaign(connection).sequence
    for one, iteration in ((other, 0), (sequence, 0), (sequence, 1)):
        generations.insert(connection, one, asked(iteration), population=[], changed=[], optimizer_state={"at": iteration})
    table = tables.generations.c
    query = select(table.campaign_sequence, table.iteration, table.optimizer_state).order_by(
        table.campaign_sequence, table.iteration
    )
    states = [tuple(row) for row in connection.execute(query)]
    assert states == [(sequence, 0, None), (sequence, 1, {"at": 1}), (other, 0, {"at": 0})]


def test_iterations_are_paged_in_order(connection: Connection) -> None:
    sequence = campaign(connection).sequence
    for iteration in (2, 0, 1):
        generations.insert(connection, sequence, asked(iteration), population=[], changed=[], optimizer_state={})
        generations.finish(connection, sequence, asked(iteration), [])
    generations.insert(connection, sequence, asked(3), population=[], changed=[], optimizer_state={})
    first, cursor = generations.page(connection, sequence, limit=2)
    second, end = generations.page(connection, sequence, limit=2, cursor=cursor)
    with pytest.raises(InvalidInputError):
        generations.page(connection, sequence, cursor="?")
    assert [each.iteration for each in first + second] == [0, 1, 2]
    assert end is None
