"""The tree of errors that drivecal raises on purpose.

Every error says in one sentence what is wrong and, where a remedy exists, what would be right. They carry plain strings only, so
that they survive pickling between processes.
"""

from __future__ import annotations

from dataclasses import dataclass


class DrivecalError(Exception):
    """The root: catch this to catch everything drivecal raises on purpose."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong with an input.

    `field` is the path of the field, dotted (`optimizer.population`); `message` says what is wrong; `remedy` what would be right.
    """

    field: str
    message: str
    remedy: str = ""

    def __str__(self) -> str:
        text = f"{self.field}: {self.message}" if self.field else self.message
        return f"{text}; {self.remedy}" if self.remedy else text


class InvalidInputError(DrivecalError):
    """The input cannot be used. `problems` names each field, what is wrong with it and what would be right."""

    def __init__(self, *problems: Problem) -> None:
        super().__init__(*problems)
        self.problems = problems

    def __str__(self) -> str:
        return "\n".join(str(problem) for problem in self.problems)


class NotFoundError(DrivecalError):
    """No such campaign, evaluation, map: `kind` and `identifier` say what was asked for, `hint` what may have been meant."""

    def __init__(self, kind: str, identifier: str, hint: str = "") -> None:
        super().__init__(kind, identifier, hint)
        self.kind = kind
        self.identifier = identifier
        self.hint = hint

    def __str__(self) -> str:
        missing = f"there is no {self.kind} {self.identifier!r}"
        return f"{missing}; {self.hint}" if self.hint else missing


class ConflictError(DrivecalError):
    """The request does not fit the state of what it is about, or contradicts an earlier request."""


class NoResultError(DrivecalError):
    """Everything was tried and nothing came of it."""


class UnavailableError(DrivecalError):
    """Something drivecal depends on (database, server, Ray) does not answer; trying again later may work."""


class DatabaseError(DrivecalError):
    """The database cannot be used as it is: no database, another program's, another version's, or held by another server."""


class SupersededError(DrivecalError):
    """Another process does this one's work by now: nothing more may be written."""


class NotAuthorisedError(DrivecalError):
    """The server does not know who is asking, or does not let them do it: a token is missing, wrong, or may only read."""


class OverloadError(UnavailableError):
    """There is no room for more at the moment. `retry_seconds`: when trying again may help."""

    def __init__(self, message: str, retry_seconds: int) -> None:
        super().__init__(message, retry_seconds)
        self.message = message
        self.retry_seconds = retry_seconds

    def __str__(self) -> str:
        return self.message


class TooLargeError(InvalidInputError):
    """The input is well-formed and asks for more than this server takes on."""


class RefutedError(DrivecalError):
    """A simulation contradicts what was proved about it."""
