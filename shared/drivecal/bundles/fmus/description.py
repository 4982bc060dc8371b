"""Reads the modelDescription.xml of an FMU (FMI 2.0 and 3.0, co-simulation): variables with their units."""

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO

from drivecal.bundles import units
from drivecal.bundles.archives import UNREADABLE
from drivecal.contracts.assignments import finite_number
from drivecal.domain.errors import InvalidInputError
from drivecal.roads.documents import Attributes, read_elements

LARGEST_DESCRIPTION = 32 << 20
LARGEST_DIRECTORY = 4 << 20
"""Bytes of the list of an archive's files, which zipfile turns into ten times as much."""
MOST_VARIABLES = 100_000
NUMBERS = frozenset({"Real", "Float32", "Float64"})
INTEGERS: Mapping[str, tuple[int, int]] = {
    "Integer": (-(2**31), 2**31 - 1),
    **{f"Int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f"UInt{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
}
"""Smallest and largest value of each type of integers."""
_WHOLE = {*INTEGERS, "Enumeration", "Boolean"}
_TYPES = NUMBERS | _WHOLE | {"String", "Binary", "Clock"}


@dataclass(frozen=True, slots=True)
class FmuVariable:
    """A variable of an FMU. `start` is None if the FMU does not give a number.

    `kind`: its type, as the FMU's version of FMI calls it; `items`: names of an enumeration's values. `unit`: as stated by the variable or
    its type, 1 if by none; `spellings`: ways to write it, none if it says nothing. `is_computed`: it takes no start value.
    """

    name: str
    causality: str
    start: float | None = None
    unit: str = "1"
    kind: str = "Real"
    items: tuple[str, ...] = ()
    spellings: tuple[str, ...] = ()
    is_array: bool = False
    is_computed: bool = False

    @property
    def is_settable(self) -> bool:
        """True if a constant can give it: arrays, binary values and clocks have no place in a manifest."""
        return not self.is_array and not self.is_computed and self.kind in NUMBERS | _WHOLE | {"String"}


Variables = Mapping[str, FmuVariable]
"""By name."""


def read_fmu(content: bytes) -> Variables | None:
    """Returns the variables of an FMU; None if it cannot be read, or is not for co-simulation by FMI 2 or 3."""
    try:
        text = _content(content)
        return parse_description(text) if len(text) <= LARGEST_DESCRIPTION else None
    except (*UNREADABLE, InvalidInputError):
        return None


def _content(whole: bytes) -> bytes:
    """Returns a modelDescription.xml, one byte more than allowed if it is larger. Raises BadZipFile."""
    if _directory_size(whole) > LARGEST_DIRECTORY:
        raise zipfile.BadZipFile(f"its directory has more than {LARGEST_DIRECTORY >> 20} MB")
    with zipfile.ZipFile(BytesIO(whole)) as archive:
        entry = archive.getinfo("modelDescription.xml")
        # zipfile expands others whole, gigabytes of 10 kB
        if entry.compress_type not in {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
            raise zipfile.BadZipFile("it is compressed by a method that FMI does not know")
        with archive.open(entry) as stream:
            return stream.read(LARGEST_DESCRIPTION + 1)


def _directory_size(whole: bytes) -> int:
    """Returns the bytes that zipfile would read as an archive's directory. Raises BadZipFile."""
    tail = whole[-(22 + (1 << 16) + 20) :]  # as far back as zipfile looks, and the locator before it
    start = len(tail) - 22 if tail[-22:-18] == b"PK\5\6" and tail[-2:] == b"\0\0" else tail.rfind(b"PK\5\6")
    if start < 0 or len(tail) < start + 22 or tail[max(0, start - 20) : start].startswith(b"PK\6\7"):
        raise zipfile.BadZipFile("it is not a zip archive, or one of format 64")
    return int.from_bytes(tail[start + 12 : start + 16], "little")


def parse_description(content: bytes) -> Variables | None:
    """Returns the variables of a modelDescription.xml; None if it is not for co-simulation by FMI 2 or 3.

    Raises InvalidInputError for XML that is damaged or has a DTD."""
    reader = _Reader()
    read_elements(content, "modelDescription.xml", "fmiModelDescription", reader.start, lambda _: None)
    return reader.variables if reader.fmi.split(".")[0] in {"2", "3"} and reader.co_simulation else None


class _Reader:
    """Collects variables from the elements of a description."""

    def __init__(self) -> None:
        self.fmi, self.co_simulation = "", False
        self._scalar: Mapping[str, str] | None = None
        """Attributes of the ScalarVariable (FMI 2) whose type comes next."""
        self._variables: list[tuple[str, dict[str, str]]] = []
        """Type and attributes of each variable."""
        self._arrays: set[int] = set()
        self._type, self._unit = "", ""
        """Names of the type and the unit that are being defined."""
        self._type_units: dict[str, str] = {}
        self._items: dict[str, list[str]] = {}
        self._base_units: dict[str, dict[str, float]] = {}

    @property
    def variables(self) -> Variables:
        """All of them, once everything is read."""
        # once: types may have as many as there are variables
        items = {name: tuple(texts) for name, texts in self._items.items()}
        variables = (
            self._variable(kind, attributes, items, is_array=index in self._arrays)
            for index, (kind, attributes) in enumerate(self._variables)
        )
        return {variable.name: variable for variable in variables}

    def start(self, element: Attributes) -> None:
        """Takes an element in. Raises InvalidInputError for too many variables."""
        tag, attributes = element.element, element.values
        if len(self._variables) > MOST_VARIABLES:
            raise element.fault(f"there are more than {MOST_VARIABLES:,} variables", "give a smaller FMU")
        if tag == "fmiModelDescription":
            self.fmi = attributes.get("fmiVersion", "")
        elif tag == "CoSimulation":
            self.co_simulation = True
        elif tag == "ScalarVariable":
            self._scalar = attributes
        elif tag in _TYPES and self._scalar is not None:
            self._variables.append((tag, {**attributes, **self._scalar}))
            self._scalar = None
        elif tag in _TYPES and "valueReference" in attributes:
            self._variables.append((tag, dict(attributes)))
        elif tag == "Alias" and self._variables:  # of FMI 3: another name of the variable around it
            kind, owner = self._variables[-1]
            self._variables.append((kind, {**owner, "name": attributes.get("name", "")}))
            self._arrays |= {len(self._variables) - 1} if len(self._variables) - 2 in self._arrays else set()
        elif tag == "Dimension" and self._variables:
            self._arrays.add(len(self._variables) - 1)
        else:
            self._define(tag, attributes)

    def _define(self, tag: str, attributes: Mapping[str, str]) -> None:
        """Reads definitions of types and units."""
        if tag == "SimpleType" or (tag.endswith("Type") and tag[:-4] in _TYPES):
            self._type = attributes.get("name", "")
        if "unit" in attributes:
            self._type_units[self._type] = attributes["unit"]
        elif tag == "Item":
            self._items.setdefault(self._type, []).append(attributes.get("name", ""))
        elif tag == "Unit":
            self._unit = attributes.get("name", "")
        elif tag == "BaseUnit":
            base = {name: number(text) for name, text in attributes.items()}
            self._base_units[self._unit] = {name: value for name, value in base.items() if value is not None}

    def _variable(
        self, kind: str, attributes: Mapping[str, str], items: Mapping[str, tuple[str, ...]], *, is_array: bool
    ) -> FmuVariable:
        """`items`: names of the values of each enumeration."""
        declared, causality = attributes.get("declaredType", ""), attributes.get("causality", "local")
        unit = attributes.get("unit") or self._type_units.get(declared) or "1"
        # FMI 3 has the start of a text in an element of its own
        is_result = causality in {"local", "output"} and "start" not in attributes and kind != "String"
        return FmuVariable(
            attributes.get("name", ""),
            causality,
            number(attributes.get("start")),
            unit,
            kind=kind,
            items=items.get(declared, ()) if kind == "Enumeration" else (),
            spellings=units.spellings(unit, self._base_units.get(unit)),
            is_array=is_array,
            is_computed=is_result
            or attributes.get("variability") == "constant"
            or causality in {"calculatedParameter", "independent"},
        )


def number(text: str | None) -> float | None:
    """Returns a finite number, 1 or 0 of a Boolean; None if there is none, or an array of several."""
    return float(text == "true") if text in {"true", "false"} else finite_number(text or "")
