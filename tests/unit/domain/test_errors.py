"""The error tree."""

import copy
import pickle

import pytest

from drivecal.domain.errors import (
    ConflictError,
    DatabaseError,
    DrivecalError,
    InvalidInputError,
    NoResultError,
    NotAuthorisedError,
    NotFoundError,
    OverloadError,
    Problem,
    SupersededError,
    TooLargeError,
    UnavailableError,
)

EXAMPLES = [
    InvalidInputError(Problem("optimizer.population", "1 is too small", "give at least 2"), Problem("", "nothing fits")),
    NotFoundError("campaign", "4f2a"),
    ConflictError("the first campaign has not ended"),
    NoResultError("no parameter set has a result in every scenario"),
    UnavailableError("the server does not answer"),
    DatabaseError("the file is no database"),
    SupersededError("another dispatcher was elected"),
    NotAuthorisedError("the server asks for a token"),
    OverloadError("1,000 campaigns wait already", 30),
    TooLargeError(Problem("optimizer.population", "10,000,000,000 cells are proposed", "give a smaller one")),
]


def test_there_is_an_example_of_every_error() -> None:
    own, waiting = set[type](), DrivecalError.__subclasses__()
    while waiting:
        error = waiting.pop()
        waiting += error.__subclasses__()
        own |= {error} if error.__module__ == DrivecalError.__module__ else set()
    assert {type(example) for example in EXAMPLES} == own, "other packages may have errors of their own"


@pytest.mark.parametrize("error", EXAMPLES, ids=lambda error: type(error).__name__)
def test_errors_survive_pickling_and_copying(error: DrivecalError) -> None:
    for other in (pickle.loads(pickle.dumps(error)), copy.deepcopy(error)):
        assert type(other) is type(error)
        assert str(other) == str(error)
        assert vars(other) == vars(error)


def test_an_invalid_input_lists_all_its_problems_a_line_each() -> None:
    assert str(InvalidInputError(Problem("a", "x"), Problem("b", "y", "z"))) == "a: x\nb: y; z"


def test_what_was_not_found_is_named() -> None:
    assert "influence map 'abc'" in str(NotFoundError("influence map", "abc"))
