"""Notes on a file: equal ones in one line, with the places that they are about, and no more than are read."""

from collections.abc import Iterable, Sequence

MOST_NOTES = 50
"""Notes on a file; the last line says how many more there are."""
MOST_PLACES = 5
"""Places that a note names."""


class JoinedNotes:
    """Notes by text, in the order of the first of each."""

    def __init__(self) -> None:
        self._places: dict[str, dict[str, None]] = {}

    def add(self, place: str, text: str) -> None:
        """Adds a note on a place, e.g. `road 7, lane -1`. The same note on the same place counts once."""
        self._places.setdefault(text, {})[place] = None

    def texts(self) -> list[str]:
        """Returns a line for each text: the first places and how many more, and the text."""
        return [f"{joined(list(places))}: {text}" for text, places in self._places.items()]


def joined(places: Sequence[str]) -> str:
    """Returns the first places, and how many more there are."""
    more = f" and {len(places) - MOST_PLACES} more" if len(places) > MOST_PLACES else ""
    return "; ".join(places[:MOST_PLACES]) + more


def cut(notes: Iterable[str], most: int = MOST_NOTES) -> tuple[str, ...]:
    """Returns the first notes, and a last one that counts the others."""
    lines = tuple(notes)
    return lines if len(lines) <= most else (*lines[:most], f"and {len(lines) - most} more notes")
