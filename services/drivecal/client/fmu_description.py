"""Reads the modelDescription.xml of an FMU (FMI 2.0 and 3.0, co-simulation): parameters, outputs and the default experiment."""

import math
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat  # DTDs and entities, which make XML dangerous, are refused below

from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem

LARGEST_DESCRIPTION = 32 << 20
MOST_VARIABLES = 100_000
_NUMBERS = {"Real", "Float32", "Float64"}
_WHOLE = {"Integer", "Enumeration", "Int8", "Int16", "Int32", "Int64", "UInt8", "UInt16", "UInt32", "UInt64"}
_TYPES = _NUMBERS | _WHOLE | {"Boolean"}
_FAULTS = (zipfile.BadZipFile, zlib.error, KeyError, OSError, EOFError, NotImplementedError, RuntimeError, ValueError)


@dataclass(frozen=True, slots=True)
class FmuVariable:
    """A scalar variable of an FMU. Numbers are None if the FMU does not give them."""

    name: str
    causality: str
    whole: bool
    """Whether only whole numbers fit: integers, enumerations, and 0 or 1 of a Boolean."""
    start: float | None = None
    lower: float | None = None
    upper: float | None = None
    unit: str = "1"
    description: str = ""


@dataclass(slots=True)
class FmuDescription:
    """Content of a modelDescription.xml. `duration` and `step` in seconds, None if there is no default experiment."""

    fmi: str = ""
    co_simulation: bool = False
    duration: float | None = None
    step: float | None = None
    variables: list[FmuVariable] = field(default_factory=list)

    @property
    def parameters(self) -> list[FmuVariable]:
        """Variables that a run may set."""
        return [variable for variable in self.variables if variable.causality in {"parameter", "structuralParameter"}]

    @property
    def outputs(self) -> list[FmuVariable]:
        """Variables that a run computes for others."""
        return [variable for variable in self.variables if variable.causality == "output"]


def read_fmu(file: str | Path) -> FmuDescription:
    """Returns the description of an FMU. Raises InvalidInputError if the file is not an FMU or cannot be calibrated."""
    name = str(file)
    try:
        with zipfile.ZipFile(name) as archive, archive.open("modelDescription.xml") as stream:
            content = stream.read(LARGEST_DESCRIPTION + 1)
    except _FAULTS as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else " ".join(str(error).split())
        raise _refused(name, f"it cannot be read as an FMU: {shown(reason, 200)}", "give an .fmu file") from error
    if len(content) > LARGEST_DESCRIPTION:
        raise _refused(name, f"its description has more than {LARGEST_DESCRIPTION >> 20} MB", "give a smaller FMU")
    description = parse_description(content, name)
    if description.fmi.split(".")[0] not in {"2", "3"}:
        raise _refused(name, f"it is of FMI version {shown(description.fmi) or 'unknown'}", "export it as FMI 2.0 or 3.0")
    if not description.co_simulation:
        raise _refused(name, "it has no co-simulation", "export it for co-simulation")
    return description


def parse_description(content: bytes, name: str = "modelDescription.xml") -> FmuDescription:
    """Returns the content of a modelDescription.xml. Raises InvalidInputError for XML that is damaged or has a DTD."""
    reader = _Reader()
    try:
        reader.parser.Parse(content, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise _refused(name, f"its description cannot be read: {shown(str(error), 200)}", "export the FMU again") from error
    return reader.description


class _Reader:
    """Collects a description from the events of expat."""

    def __init__(self) -> None:
        self.description = FmuDescription()
        self.parser = expat.ParserCreate()
        self.parser.StartDoctypeDeclHandler = self._refuse
        self.parser.EntityDeclHandler = self._refuse
        self.parser.StartElementHandler = self._start
        self._scalar: Mapping[str, str] | None = None
        """Attributes of the ScalarVariable (FMI 2) whose type comes next."""

    def _refuse(self, *_: object) -> None:
        raise ValueError("DTDs and entities are not supported")

    def _start(self, tag: str, attributes: Mapping[str, str]) -> None:
        if tag == "fmiModelDescription":
            self.description.fmi = attributes.get("fmiVersion", "")
        elif tag == "CoSimulation":
            self.description.co_simulation = True
        elif tag == "DefaultExperiment":
            start = _number(attributes.get("startTime")) or 0.0
            stop, self.description.step = _number(attributes.get("stopTime")), _number(attributes.get("stepSize"))
            self.description.duration = None if stop is None or stop <= start else stop - start
        elif tag == "ScalarVariable":
            self._scalar = attributes
        elif tag in _TYPES and self._scalar is not None:
            self._add(tag, {**attributes, **self._scalar})
            self._scalar = None
        elif tag in _TYPES and "valueReference" in attributes:
            self._add(tag, attributes)

    def _add(self, kind: str, attributes: Mapping[str, str]) -> None:
        if len(self.description.variables) >= MOST_VARIABLES:
            raise ValueError(f"it has more than {MOST_VARIABLES:,} variables")
        lower, upper = ("0", "1") if kind == "Boolean" else (attributes.get("min"), attributes.get("max"))
        variable = FmuVariable(
            attributes.get("name", ""),
            attributes.get("causality", "local"),
            kind not in _NUMBERS,
            _number(attributes.get("start")),
            _number(lower),
            _number(upper),
            attributes.get("unit", "1"),
            attributes.get("description", ""),
        )
        self.description.variables.append(variable)


def _number(text: str | None) -> float | None:
    """Returns a finite number; None if there is none, or an array of several."""
    if text in {"true", "false"}:
        return float(text == "true")
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _refused(name: str, message: str, remedy: str) -> InvalidInputError:
    return InvalidInputError(Problem(shown(name, 200), message, remedy))
