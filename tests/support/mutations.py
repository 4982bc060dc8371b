"""Damage to XML files: bytes, attributes and elements, and attempts that must end with a result or a named refusal."""

import os
import random
import re
import signal
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from drivecal.domain.errors import InvalidInputError, Problem

SECONDS = 20
"""Time after which a single try counts as a hang; each takes milliseconds, and netconvert less than a second."""
STRANGE = (
    "", "0", "-1", "1e308", "-1e308", "nan", "inf", "1e-320", "0x10", "١", "1_0", "99999999999999999999", "a" * 300, "\u202e", "before",
    "before_0", ":b_0", "0,0", "0,0 0,0", "0,0 1e9,1e9", "0,0 1,1,1 2,2", "-0.0,5 5,-0.0", " ", "true", "internal", "driving", "0.1 0.2",
    "/etc/passwd",
)  # fmt: skip

PLACES = tuple(
    os.path.realpath(place) + os.sep
    for place in (tempfile.gettempdir(), sys.prefix, sys.base_prefix, Path(__file__).parents[2])
)
"""Folders whose files an attempt may open: temporary ones, installed packages, and this project, whose lines tracebacks show."""


def mutated(content: bytes, chance: random.Random) -> bytes:
    """The content with one to three faults: of bytes, of attributes, of elements."""
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        content = chance.choice((other_value, other_value, other_value, without_element, twice, byte, cut, swapped))(
            content, chance
        )
    return content


def attribute(content: bytes, chance: random.Random) -> tuple[int, int]:
    places = [match.span(1) for match in re.finditer(rb'="([^"]*)"', content)]
    return chance.choice(places) if places else (0, 0)


def other_value(content: bytes, chance: random.Random) -> bytes:
    first, last = attribute(content, chance)
    value = chance.choice(STRANGE).encode()
    if chance.random() < 0.3:  # a digit more
        value = content[first:last] + str(chance.randrange(10)).encode()
    return content[:first] + value + content[last:]


def nudged(content: bytes, chance: random.Random) -> bytes:
    """The content with one to five other numbers in its attributes: still a file of its kind, with which programs go on."""
    for _ in range(chance.randrange(1, 6)):
        places = [match.span() for match in re.finditer(rb"(?<=[\" ,])-?\d+\.?\d*(?=[\" ,])", content)]
        if not places:
            break
        first, last = chance.choice(places)
        number = float(content[first:last])
        other = number * chance.choice((0.0, 0.5, 0.97, 1.03, 1.5, -1.0)) + chance.choice((0.0, 0.0, 1.0, -1.0))
        text = f"{other:.2f}" if b"." in content[first:last] else f"{other:.0f}"
        content = content[:first] + text.encode() + content[last:]
    return content


def swapped(content: bytes, chance: random.Random) -> bytes:
    (first, last), (begin, end) = attribute(content, chance), attribute(content, chance)
    return content[:first] + content[begin:end] + content[last:]


def element(content: bytes, chance: random.Random) -> tuple[int, int]:
    places = [match.span() for match in re.finditer(rb"<\w[^>]*/>|</\w+>|<\w[^>]*>", content)]
    return chance.choice(places) if places else (0, 0)


def without_element(content: bytes, chance: random.Random) -> bytes:
    first, last = element(content, chance)
    return content[:first] + content[last:]


def twice(content: bytes, chance: random.Random) -> bytes:
    first, last = element(content, chance)
    return content[:last] + content[first:last] * chance.choice((1, 1, 50)) + content[last:]


def byte(content: bytes, chance: random.Random) -> bytes:
    place = chance.randrange(max(1, len(content)))
    return content[:place] + bytes([chance.randrange(256)]) + content[place + 1 :]


def cut(content: bytes, chance: random.Random) -> bytes:
    return content[: chance.randrange(max(1, len(content)))] if chance.random() < 0.2 else content


_watched: tuple[int, list[str]] | None = None
"""The thread of an attempt, and what it opens elsewhere."""


def _note(event: str, arguments: tuple[object, ...]) -> None:
    if event != "open" or _watched is None or not isinstance(arguments[0], str | bytes):
        return
    thread, strays = _watched
    path = os.path.realpath(os.fsdecode(arguments[0]))
    if thread == threading.get_ident() and not f"{path}{os.sep}".startswith(PLACES):
        strays.append(path)


@cache
def _watch() -> None:
    """Adds the hook, which stays as long as the process and makes every import and query of other tests slower."""
    sys.addaudithook(_note)


@contextmanager
def at_home() -> Iterator[None]:
    """Fails if Python opens a file elsewhere than in `PLACES` in this thread. Programs that it starts are not seen."""
    global _watched  # noqa: PLW0603  # the hook of the process cannot be taken away
    _watch()
    strays: list[str] = []
    _watched = threading.get_ident(), strays
    try:
        yield
    finally:
        _watched = None
    assert not strays, strays


@contextmanager
def soon() -> Iterator[None]:
    """Fails after a while. The test's own time limit goes on afterwards."""

    def late(*_: object) -> None:
        raise AssertionError("it hangs")

    before = signal.signal(signal.SIGALRM, late)
    left, _ = signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, left)
        signal.signal(signal.SIGALRM, before)


def outcome(attempt: Callable[[], object]) -> bool:
    """Returns whether the attempt succeeds; any exception but InvalidInputError fails the test, and so does a hang or a file elsewhere."""
    problems: tuple[Problem, ...] = ()
    with warnings.catch_warnings(), soon(), at_home():
        warnings.simplefilter("error")
        try:
            attempt()
        except InvalidInputError as error:
            problems = error.problems
    assert all(problem.message and problem.field for problem in problems)
    return not problems
