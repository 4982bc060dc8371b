"""What a suite of faults did to servers, and what came of it: noted by lives, carried by the tests' reports, told at the end."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

from pydantic import TypeAdapter

TARGET = Path(".drivecal/bench/faults.json")
PROPERTY = "life"


@dataclass
class Note:
    """One life of a server, as JSON has it."""

    database: str
    faults: list[tuple[str, float | None]] = field(default_factory=list)
    """Each with the seconds from its end (what was killed is gone, what was stopped goes on) until the server could work again; None if
    the next fault came before."""
    accepted: int = 0
    """Campaigns and single evaluations that the server took."""
    as_without_faults: bool = False
    """Whether everything accepted was there at the end, once, and with the bits of a run without faults."""


NOTES: list[Note] = []
"""Of the test that runs."""


def noted(database_url: str) -> Note:
    """Returns the note of a life that begins now, as the test's report carries it."""
    NOTES.append(Note(database_url.partition(":")[0].partition("+")[0]))
    return NOTES[-1]


CARRIED = TypeAdapter(list[Note])
"""Notes as a report of pytest carries them from one process to another."""


@dataclass(frozen=True)
class Told:
    """Describes what a test told: its name without cases, whether it passed, how long it took (s), and its lives."""

    test: str
    passed: bool
    seconds: float
    lives: Sequence[Note]


def table(told: Iterable[Told]) -> list[dict[str, object]]:
    """Returns a row for each test and database."""
    groups: dict[tuple[str, str], list[tuple[Told, Note | None]]] = defaultdict(list)
    for one in told:
        notes: list[Note | None] = [*one.lives]
        for note in notes or [None]:
            groups[one.test, note.database if note else ""].append((one, note))
    rows: list[dict[str, object]] = []
    for (test, database), members in groups.items():
        lives = [note for _, note in members if note is not None]
        seconds = [ready for note in lives for _, ready in note.faults if ready is not None]
        cases = {id(one): one for one, _ in members}.values()
        rows.append(
            {
                "test": test,
                "database": database,
                "failed": sum(not case.passed for case in cases),
                "of": len(cases),
                "minutes": sum(case.seconds for case in cases) / 60,
                "faults": sum(len(note.faults) for note in lives) if lives else None,
                "ready again, median s": median(seconds) if seconds else None,
                "ready again, longest s": max(seconds, default=None),
                "accepted": sum(note.accepted for note in lives) if lives else None,
                "lost or changed": sum(not note.as_without_faults for note in lives) if lives else None,
            }
        )
    return rows


def lines(rows: Sequence[Mapping[str, object]]) -> list[str]:
    """Returns the table as Markdown."""
    names = list(rows[0])

    def shown(value: object) -> str:
        return "" if value is None else f"{value:.1f}" if isinstance(value, float) else str(value)

    body = [f"| {' | '.join(shown(row[name]) for name in names)} |" for row in rows]
    return [f"| {' | '.join(names)} |", "|" + "---|" * len(names), *body]


def by_kind(told: Iterable[Told]) -> dict[str, dict[str, int]]:
    """Returns how many faults of each kind each database saw."""
    counted: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
    for one in told:
        for life in one.lives:
            for name, _ in life.faults:
                counted[life.database][name] += 1
    return {database: dict(sorted(kinds.items())) for database, kinds in counted.items()}
