"""Times of a route file and of a run: which vehicles and flows of the file belong to the run, and what is left of a flow."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil, inf

from drivecal.bundles.traffic.elements import Element, finite
from drivecal.contracts.strict_json import shown

LONG = 1e9
NEGLIGIBLE = 1e-9
"""Share of a period by which rounding may move a vehicle beyond a limit."""


@dataclass(frozen=True, slots=True)
class Clock:
    """Times of a run in a route file (s): `begin`, at which the controlled vehicle starts, `warm_up` before it, and `duration`."""

    begin: float
    warm_up: float
    duration: float

    @property
    def first(self) -> float:
        """Time of the file at which the first vehicles may enter."""
        return self.begin - self.warm_up

    @property
    def end(self) -> float:
        """Time of the file at which the run ends."""
        return self.begin + self.duration

    def shifted(self, time: float) -> float:
        """Returns the run's time of a time of the file. Rounding keeps differences of times of day as they are written."""
        return round(time - self.begin, 6) if self.begin else time


@dataclass(frozen=True, slots=True)
class Stream:
    """Departures of a flow: `per_hour` from `begin` to `end` (s), by default without end, at most `number`; evenly or at `random`."""

    begin: float
    end: float | None
    number: int | None
    per_hour: float
    random: bool = False

    @property
    def period(self) -> float:
        """Seconds between two vehicles, or their mean."""
        return 3600.0 / self.per_hour

    def passed(self, time: float) -> int:
        """Returns how many vehicles depart before a time: if they come at random, their mean, rounded."""
        periods = max(time - self.begin, 0.0) / self.period
        return round(periods) if self.random else ceil(periods - NEGLIGIBLE)

    def after(self, time: float) -> "Stream | None":
        """Returns the departures from a time on, at the same rate and, if they are even, at the same times; None if there are none."""
        if time <= self.begin:
            return self
        passed = self.passed(time)
        begin = time if self.random else self.begin + passed * self.period
        number = None if self.number is None else self.number - passed
        if (number is not None and number < 1) or (self.end is not None and self.end <= begin):
            return None
        return replace(self, begin=begin, number=number)

    def departures(self, first: float, end: float) -> Iterator[tuple[int, float]]:
        """Yields number and time of each of the even departures in the time from `first` to before `end`."""
        last = min(end, inf if self.end is None else self.end)
        index = self.passed(first)
        while self.number is None or index < self.number:
            time = self.begin + index * self.period
            if time >= last - NEGLIGIBLE * self.period:
                return
            yield index, time
            index += 1


def seconds(element: Element, key: str, default: float | None) -> float:
    """Returns a time in seconds, which may be written as hours, minutes and seconds with colons."""
    parts = element.text(key, None if default is None else repr(default)).split(":")
    values = [finite(part) for part in parts]
    total = 0.0
    for value, unit in zip(reversed(values), (1.0, 60.0, 3600.0, 86400.0), strict=False):
        total += (value or 0.0) * unit
    if not 1 <= len(parts) <= 4 or any(value is None for value in values) or not abs(total) <= LONG:
        raise element.fault(f"{key} is {shown(element.text(key), 40)}, which is not a time", "give seconds, e.g. 12.5")
    return total
