"""Parts of a storyboard, to which its conditions refer by names: stories, acts, groups of maneuvers, maneuvers, events and actions."""

from dataclasses import dataclass, field
from itertools import combinations

from drivecal.bundles.traffic.elements import Element
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError

MOST_PARTS = 10_000


@dataclass(eq=False, slots=True)
class Part:
    """A part of a storyboard: the names from its story to itself, the part around it, and the ids of the traffic's actions inside."""

    kind: str
    element: Element
    path: tuple[str, ...]
    owner: "Part | None"
    actions: list[str] = field(default_factory=list)

    def add(self, action: str) -> None:
        """Adds an action to the part and to those around it."""
        self.actions.append(action)
        if self.owner is not None:
            self.owner.add(action)

    def holds(self, element: Element) -> bool:
        """Returns whether an element lies inside of the part."""
        around: Element | None = element
        while around is not None and around is not self.element:
            around = around.parent
        return around is not None

    def __str__(self) -> str:
        return f"{shown('::'.join(self.path), 200)} (line {self.element.line})"


class Parts:
    """All parts of a storyboard."""

    def __init__(self) -> None:
        self._by_names: dict[tuple[str, tuple[str, ...]], list[Part]] = {}
        self._count = 0

    def new(self, kind: str, element: Element, owner: Part | None = None) -> Part:
        """Returns a part of a kind as references call it. Raises InvalidInputError if there are too many."""
        self._count += 1
        if self._count > MOST_PARTS:
            raise element.fault(f"the storyboard has more than {MOST_PARTS:,} parts", "leave some out")
        outer = owner.path if owner is not None else ()
        part = Part(kind, element, (*outer, element.text("name", "")), owner)
        for around in {names for size in range(len(outer) + 1) for names in combinations(outer, size)}:
            self._by_names.setdefault((kind, (*around, part.path[-1])), []).append(part)
        return part

    def referred(self, condition: Element) -> Part:
        """Returns the part that a condition refers to: by its name, after any names of parts around it, in their order.

        Raises InvalidInputError if there is none with actions of the traffic, or several.
        """
        kind, reference = condition.text("storyboardElementType"), condition.text("storyboardElementRef")
        parts = self._by_names.get((kind, tuple(reference.split("::"))), [])
        if len(parts) > 1:
            raise _ambiguous(condition, reference, parts)
        if not parts or not parts[0].actions:
            message = f"there is no {shown(kind, 40)} {shown(reference, 200)} with actions of the traffic"
            raise condition.fault(message, "give an element of the file that does not drive the ego vehicle only")
        return parts[0]


def _ambiguous(condition: Element, reference: str, parts: list[Part]) -> InvalidInputError:
    message = f"{shown(reference, 200)} may be {parts[0]} or {parts[1]}"
    if parts[0].path == parts[1].path:
        return condition.fault(message, "rename one of them")
    return condition.fault(message, "put names of the elements around it before its name, with :: between them")
