"""Small XML documents as trees that record which parts were read: the rest is listed as ignored."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

from drivecal.domain.errors import InvalidInputError
from drivecal.roads.documents import Attributes, read_elements
from drivecal.roads.notes import cut

MOST_ELEMENTS = 200_000
LONGEST_NOTE = 200
"""Characters of a note on attributes."""
NAMING = ("name",)
"""Attributes that only name elements."""
Substitution = Callable[["Element", str], str]
"""Returns the text of an attribute with a parameter in it."""


class Element(Attributes):
    """An element with those inside of it. Its attributes are read as `Attributes` does, with parameters replaced by their values."""

    __slots__ = ("children", "is_read", "known", "parameters", "parent", "substitution")

    def __init__(self, attributes: Attributes, parent: "Element | None", substitution: Substitution | None) -> None:
        super().__init__(attributes.file, attributes.element, attributes.values, attributes.line)
        self.parent, self.substitution = parent, substitution
        self.children: list[Element] = []
        self.parameters: dict[str, str] = {}
        """Values of the parameters that are declared here."""
        self.is_read = False
        self.known: list[str] = []
        """Attributes that were read."""

    def copy(self, parent: "Element | None" = None) -> "Element":
        """Returns the element with all inside of it, below `parent` or its own."""
        copied = Element(self, parent or self.parent, self.substitution)
        copied.parameters = dict(self.parameters)
        copied.children = [child.copy(copied) for child in self.children]
        return copied

    def text(self, key: str, default: str | None = None) -> str:
        """Returns an attribute. Raises InvalidInputError if it is missing and has no default."""
        self.known.append(key)
        text = super().text(key, default)
        return text if self.substitution is None or "$" not in text else self.substitution(self, text)

    def number(self, key: str, lower: float, upper: float, default: float | None = None) -> float:
        """Returns a finite number between two bounds. Raises InvalidInputError."""
        self.known.append(key)
        return super().number(key, lower, upper, default)

    def decides(self, key: str, default: str) -> bool:
        """Returns a truth value: true, false, 1 or 0. Raises InvalidInputError for others."""
        text = self.text(key, default).strip().lower()
        if text not in {"true", "false", "1", "0"}:
            raise self.fault(f"{key} is {text[:40]!r}, which is neither true nor false", "correct it")
        return text in {"true", "1"}

    def word(self, key: str, known: Mapping[str, object] | tuple[str, ...], default: str | None = None) -> str:
        """Returns an attribute that is one of `known`. Raises InvalidInputError for others."""
        text = self.text(key, default)
        if text not in known:
            raise self.fault(f"{key} is {text[:60]!r}, which is not supported", f"give one of {', '.join(known)}")
        return text

    def every(self, *tags: str) -> "list[Element]":
        """Returns the elements with these tags inside of this one, in the order of the file."""
        inside = [child for child in self.children if child.element in tags]
        for child in inside:
            child.is_read = True
        return inside

    def optional(self, *tags: str) -> "Element | None":
        """Returns the element with one of these tags, None if there is none. Raises InvalidInputError if there are several."""
        inside = self.every(*tags)
        if len(inside) > 1:
            raise inside[1].fault(f"<{self.element}> has several of them", "give one")
        return inside[0] if inside else None

    def only(self, *tags: str) -> "Element":
        """Returns the element with one of these tags. Raises InvalidInputError if there is none, or several."""
        child = self.optional(*tags)
        if child is None:
            others = [f"<{other.element}> (line {other.line})" for other in self.children[:3]]
            message = f"{' and '.join(others)} is not supported" if others else f"there is no <{tags[0]}>"
            raise self.fault(message, f"give {' or '.join(f'<{tag}>' for tag in tags)}")
        return child

    def entity(self, ids: Mapping[str, str]) -> str:
        """Returns the id of the entity that this element refers to. Raises InvalidInputError if it is not in `ids`."""
        name = self.text("entityRef")
        if name not in ids:
            raise self.fault(f"there is no entity {name[:60]!r}", f"give one of {', '.join(list(ids)[:10])}")
        return ids[name]

    def skip(self) -> None:
        """Marks everything in this element as read."""
        self.is_read = True
        self.known += self.values
        for child in self.children:
            child.skip()

    def unread(self) -> "Iterator[Element]":
        """Yields the outermost elements that were not read."""
        for child in self.children:
            if child.is_read:
                yield from child.unread()
            else:
                yield child

    def read_in_part(self) -> "Iterator[tuple[Element, list[str]]]":
        """Yields the elements that were read, with those of their attributes that were not."""
        if rest := [key for key in self.values if key not in NAMING and key not in self.known]:
            yield self, rest
        for child in self.children:
            if child.is_read:
                yield from child.read_in_part()


class Notes:
    """Notes on a file: what is ignored or driven otherwise, with the lines."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._lines: dict[tuple[str, str], list[int]] = {}

    def add(self, element: Attributes, text: str) -> None:
        """Adds a note on an element."""
        self._lines.setdefault((element.element, text), []).append(element.line)

    def texts(self, root: Element) -> tuple[str, ...]:
        """Returns the notes, those of equal text in one, and one on each element and attribute below `root` that was not read.

        Attributes of entities are not noted: masses, names of models and heights do not drive.
        """
        for element in root.unread():
            self.add(element, "ignored")
        for section in root.every("Storyboard"):
            for element, keys in section.read_in_part():
                self.add(element, f"ignored: {', '.join(keys)}"[:LONGEST_NOTE])
        notes = sorted(self._lines.items(), key=lambda entry: entry[1][0])
        return tuple(
            f"{self._name}: {note}" for note in cut(f"{_lines(sorted(lines))}, <{tag}>: {text}" for (tag, text), lines in notes)
        )


def _lines(lines: list[int]) -> str:
    shown = ", ".join(map(str, lines[:10]))
    more = f" and {len(lines) - 10} more" if len(lines) > 10 else ""
    return f"line{'s' if len(lines) > 1 else ''} {shown}{more}"


def read_tree(content: bytes, name: str, root: str, substitution: Substitution | None = None) -> Element:
    """Returns the document's element. `name`: the file's in messages; `root`: its tag. Raises InvalidInputError."""
    stack: list[Element] = []
    whole: list[Element] = []
    count = 0

    def start(attributes: Attributes) -> None:
        nonlocal count
        count += 1
        if count > MOST_ELEMENTS:
            raise attributes.fault(f"the document has more than {MOST_ELEMENTS:,} elements", "cut the part out that is driven")
        element = Element(attributes, stack[-1] if stack else None, substitution)
        (stack[-1].children if stack else whole).append(element)
        stack.append(element)

    def end(_: str) -> None:
        stack.pop()

    read_elements(content, name, root, start, end)
    whole[0].is_read = True
    return whole[0]


def finite(text: str) -> float | None:
    """Returns the number in a text, None if there is none."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) and "_" not in text else None


def refusal(error: InvalidInputError, place: str) -> InvalidInputError:
    """Returns an error whose problems have the field `place`, and say in their message where in the file they are."""
    return InvalidInputError(
        *(replace(problem, field=place, message=f"{problem.field}: {problem.message}") for problem in error.problems)
    )
