"""Chooses the reader or writer of a calibration file."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePath
from typing import Literal

from drivecal.calibration_data import a2l, cdfx, dcm
from drivecal.calibration_data.characteristics import Characteristic, Content, Quality
from drivecal.contracts.strict_json import shown
from drivecal.contracts.tables import csv_text
from drivecal.domain.errors import InvalidInputError, Problem

CalibrationFormat = Literal["dcm", "cdfx", "csv"]
COLUMNS = ("name", "value", "unit", "lower", "upper", "description")
READERS: Mapping[str, Callable[[bytes, str], Content]] = {".a2l": a2l.read, ".dcm": dcm.read, ".cdfx": cdfx.read}


def read(content: bytes, file: str) -> Content:
    """Returns the content of an `.a2l`, `.dcm` or `.cdfx` file. Raises InvalidInputError with the line of the first fault."""
    suffix = PurePath(file).suffix.lower()
    if suffix not in READERS:
        raise InvalidInputError(Problem(shown(file, 200), f"{shown(suffix)} is no known format", f"give {', '.join(READERS)}"))
    return READERS[suffix](content, file)


def write(form: CalibrationFormat, characteristics: Sequence[Characteristic], quality: Quality | None) -> bytes:
    """Returns a file. CSV, in UTF-8, has a row for each characteristic and no quality data."""
    if form == "csv":
        rows = ((row.name, row.given, row.unit, row.lower, row.upper, row.description) for row in characteristics)
        return csv_text([COLUMNS, *rows]).encode()
    return dcm.write(characteristics, quality) if form == "dcm" else cdfx.write(characteristics, quality)


def labels_of(document: object, parameters: Sequence[str] | None = None) -> dict[str, str]:
    """Returns a checked file of labels by parameter, `{P1: ACC_tGap_C}`. It may hold more than the `parameters`, if these are known."""
    if not isinstance(document, dict):
        raise InvalidInputError(Problem("--names", "it is not a list of names", "give lines such as P1: ACC_tGap_C"))
    problems, used = [], dict[str, str]()
    for name, label in document.items():
        field = shown(name)
        if not isinstance(label, str) or not label.strip() or not label.isprintable() or '"' in label or " " in label.strip():
            problems.append(Problem(field, f"{shown(label)} is not a label", "give a name without spaces"))
        elif parameters is not None and label != name and label in parameters and label not in document:
            problems.append(Problem(field, f"the parameter {label} has this name", f"give {label} another label, too"))
        elif label in used:
            problems.append(Problem(field, f"{used[label]} has the label {label}, too", "give each parameter its own"))
        else:
            used[label] = name
    if problems:
        raise InvalidInputError(*problems)
    return {name: label for label, name in used.items()}
