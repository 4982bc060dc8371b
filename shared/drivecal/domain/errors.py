"""Exceptions that drivecal raises on purpose, and the collector of all problems of an input.

Each message states in one sentence what is wrong and, if a remedy exists, how to fix it. Exceptions carry plain strings only, so that
they survive pickling between processes.
"""

import csv
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, ParamSpec, TypeVar

LONGEST_DETAIL = 500
"""Largest length of an error's description in characters."""


class DrivecalError(Exception):
    """Base class of all exceptions that drivecal raises on purpose."""


@dataclass(frozen=True, slots=True)
class Problem:
    """A fault of an input.

    `field`: the dotted path of the field (`optimizer.population`); `message` describes the fault; `remedy`: how to fix it.
    """

    field: str
    message: str
    remedy: str = ""

    def __str__(self) -> str:
        text = f"{self.field}: {self.message}" if self.field else self.message
        return f"{text}; {self.remedy}" if self.remedy else text


class InvalidInputError(DrivecalError):
    """The input is invalid. `problems` lists each faulty field with its fault and remedy."""

    def __init__(self, *problems: Problem) -> None:
        super().__init__(*problems)
        self.problems = problems

    def __str__(self) -> str:
        return "\n".join(str(problem) for problem in self.problems)


class NotFoundError(DrivecalError):
    """The requested campaign, evaluation or map does not exist.

    `kind` and `identifier` name the request; `hint` suggests what the user may have meant.
    """

    def __init__(self, kind: str, identifier: str, hint: str = "") -> None:
        super().__init__(kind, identifier, hint)
        self.kind = kind
        self.identifier = identifier
        self.hint = hint

    def __str__(self) -> str:
        missing = f"there is no {self.kind} {self.identifier!r}"
        return f"{missing}; {self.hint}" if self.hint else missing


class ConflictError(DrivecalError):
    """The request does not fit the state of its object, or contradicts an earlier request."""


class NoResultError(DrivecalError):
    """No result exists after all attempts, or a vehicle cannot do what the scenario says."""


class UnavailableError(DrivecalError):
    """A dependency of drivecal (database, server, Ray) does not respond; a later attempt may succeed."""


class DatabaseError(DrivecalError):
    """The database cannot be used: it is missing, belongs to another program or version, or is held by another server."""


class SupersededError(DrivecalError):
    """Another process has taken over the work of this one, which must not write any more."""


class NotAuthorisedError(DrivecalError):
    """The server refuses the request: its token is missing, wrong, or read-only."""


class OverloadError(UnavailableError):
    """The server is at capacity. `retry_seconds`: the time after which to try again."""

    def __init__(self, message: str, retry_seconds: int) -> None:
        super().__init__(message, retry_seconds)
        self.message = message
        self.retry_seconds = retry_seconds

    def __str__(self) -> str:
        return self.message


class TooLargeError(InvalidInputError):
    """The input is valid but exceeds a limit of this server."""


@contextmanager
def restated(change: Callable[[Problem], Problem]) -> Iterator[None]:
    """Changes the problems of an InvalidInputError that leaves the block, e.g. to fields that the user knows."""
    try:
        yield
    except InvalidInputError as error:
        raise InvalidInputError(*map(change, error.problems)) from error


@contextmanager
def file_faults(file: object, verb: Literal["read", "written"], remedy: str) -> Iterator[None]:
    """Raises InvalidInputError if the block cannot read or write a file, with the reason of the system."""
    try:
        yield
    except (OSError, ValueError, RecursionError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise InvalidInputError(Problem(str(file), f"it cannot be {verb}: {reason}", remedy)) from error


def describe(error: BaseException) -> str:
    """Returns an error as one printable line: only the message of drivecal's own errors, type and location of others."""
    frames = traceback.extract_tb(error.__traceback__)
    if isinstance(error, DrivecalError) or not frames:
        message, location = str(error), ""
    else:
        message = "".join(traceback.format_exception_only(error))
        location = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})"
    message = " ".join(message.split())
    text = message[: LONGEST_DETAIL - len(location)] + location
    return "".join(character if character.isprintable() else "?" for character in text)


T = TypeVar("T")
Given = ParamSpec("Given")


def attempted(make: Callable[Given, T], *given: Given.args, **named: Given.kwargs) -> T | InvalidInputError:
    """Returns what a call returns, or the error that it raises for faulty input."""
    try:
        return make(*given, **named)
    except InvalidInputError as error:
        return error


def problems_of(part: object) -> Sequence[Problem]:
    """Returns the problems of an error for faulty input; none of anything else."""
    return part.problems if isinstance(part, InvalidInputError) else ()


MOST_FINDINGS = 1_000
"""A hostile megabyte of start sets has a hundred times as many."""


class Diagnostics:
    """Problems in order of discovery, and notes."""

    def __init__(self) -> None:
        self.problems: list[Problem] = []
        self.notes: list[str] = []

    def add(self, field: str, message: str, remedy: str = "") -> None:
        """Adds a problem, up to a limit."""
        if len(self.problems) < MOST_FINDINGS:
            self.problems.append(Problem(field, message, remedy))

    def attempt(self, make: Callable[[], T]) -> T | None:
        """Returns what `make` returns; None if it raises InvalidInputError, whose problems are added."""
        made = attempted(make)
        self.problems.extend(problems_of(made))
        return None if isinstance(made, InvalidInputError) else made

    def found(self, part: T | None) -> T:
        """Returns a part that is there if there are no problems. Raises InvalidInputError with all problems."""
        self.raise_if_any()
        if part is None:
            raise AssertionError("a part is missing without a finding")
        return part

    def raise_if_any(self) -> None:
        """Raises InvalidInputError with all problems."""
        if self.problems:
            raise InvalidInputError(*self.problems)
