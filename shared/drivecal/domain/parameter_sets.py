"""Parameter sets: exact values by name, with a key that depends on nothing else."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal

from drivecal.domain.values import BILLION, Setting, Value, billionths_text, code, entry, from_billionths


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """A value per parameter, in billionths or as the text of a choice, in the driving function's order of names."""

    names: tuple[str, ...]
    billionths: tuple[int | str, ...]

    @classmethod
    def of(cls, values: Mapping[str, Value]) -> ParameterSet:
        """Creates a parameter set from exact decimals and texts by name."""
        return cls(tuple(values), tuple(map(entry, values.values())))

    @classmethod
    def from_json(cls, document: str) -> ParameterSet:
        """Inverts `to_json`."""
        values: dict[str, Value] = json.loads(document, parse_float=Decimal, parse_int=Decimal)
        return cls.of(values)

    @property
    def values(self) -> dict[str, Value]:
        """Exact decimals and texts by name."""
        pairs = zip(self.names, self.billionths, strict=True)
        return {name: value if isinstance(value, str) else from_billionths(value) for name, value in pairs}

    @property
    def floats(self) -> dict[str, Setting]:
        """Nearest floats by name, and the texts of choices, as used by simulators, JSON and tables."""
        # A quotient of integers is rounded once, like the decimal, in a tenth of the time.
        pairs = zip(self.names, self.billionths, strict=True)
        return {name: value if isinstance(value, str) else value / BILLION for name, value in pairs}

    @property
    def codes(self) -> tuple[int, ...]:
        """Integers that identify the values, see `code`."""
        return tuple(map(code, self.billionths))

    def to_json(self) -> str:
        """Returns exact, readable JSON: `{"P1": 0.5, "mode": "eco", ...}`."""
        pairs = zip(self.names, self.billionths, strict=True)
        return "{" + ", ".join(f"{json.dumps(name)}: {_stored_text(value)}" for name, value in pairs) + "}"

    @property
    def key(self) -> bytes:
        """Key of 16 bytes that identifies the set, independent of bounds, steps, lists of choices and order of names."""
        pairs = sorted(zip(self.names, self.billionths, strict=True), key=lambda pair: pair[0])
        # A text is quoted, so that no text reads like a number or like further parameters.
        canonical = ";".join(f"{name}={json.dumps(value) if isinstance(value, str) else value}" for name, value in pairs)
        return hashlib.blake2b(canonical.encode(), digest_size=16).digest()


def _stored_text(value: int | str) -> str:
    return json.dumps(value) if isinstance(value, str) else billionths_text(value)
