"""What files become: entries of a scenario's traffic and flows, each with the element that it comes from."""

import re
from collections.abc import Iterable
from typing import Any, Literal, NamedTuple

from drivecal.bundles.highway_actions import EGO
from drivecal.bundles.traffic.elements import Element

_OTHER = re.compile(r"[^A-Za-z0-9_-]")
LONGEST = 64


class Entry(NamedTuple):
    """An entry of a scenario's section, as a document."""

    section: Literal["traffic", "flows"]
    document: dict[str, Any]
    element: Element


class VehicleNames:
    """Ids of vehicles: names of files as they are, if they are ids, each only once."""

    def __init__(self, taken: Iterable[str | None]) -> None:
        self._taken = {EGO, *(name for name in taken if name is not None)}
        self._given: set[str] = set()

    def new(self, name: str, element: Element) -> str:
        """Returns the id of a vehicle of a file. Raises InvalidInputError if the file has another of this name."""
        if name in self._given:
            raise element.fault("another vehicle has the same name", "rename one")
        self._given.add(name)
        base = _OTHER.sub("_", name)[: LONGEST - 4] or "_"
        free, number = base, 1
        while free in self._taken:
            free, number = f"{base}-{number}", number + 1
        self._taken.add(free)
        return free
