"""The `parameters` and `baseline` sections of a problem, from characteristics of files."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Any

from drivecal.calibration_data.characteristics import Characteristic
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem

LARGEST = 1e6
"""Largest number that a parameter of drivecal may have."""
MOST_PARAMETERS = 200
SINGLE = 2.0**-23
"""Relative precision of a number of 32 bits."""
CHANGE = 1e-6
"""Largest change of a value that is written with nine decimals, as a share of its range."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]{0,63}")


@dataclass(slots=True)
class Sections:
    """`parameters` and `baseline`, ready for `problem.yaml`. `guessed`: parameters whose range is only a span around their value.
    `left_out`: texts whose choices no file has, as in a DCM without its A2L."""

    parameters: dict[str, dict[str, Any]] = field(default_factory=dict)
    baseline: dict[str, float | str] = field(default_factory=dict)
    guessed: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)


def joined(files: Iterable[Sequence[Characteristic]]) -> list[Characteristic]:
    """Returns the characteristics of several files by name: what a later file does not say, an earlier one may, e.g. limits of an A2L for
    the values of a DCM."""
    result: dict[str, Characteristic] = {}
    for characteristics in files:
        for new in characteristics:
            known = result.get(new.name)
            result[new.name] = new if known is None else _joined(known, new)
    return list(result.values())


def _joined(known: Characteristic, new: Characteristic) -> Characteristic:
    return replace(
        known,
        value=known.value if new.value is None else new.value,
        unit=known.unit if new.unit == "1" else new.unit,
        description=new.description or known.description,
        lower=known.lower if new.lower is None else new.lower,
        upper=known.upper if new.upper is None else new.upper,
        step=new.step or known.step,
        integer=new.integer or known.integer,
        choices=new.choices or known.choices,
        codes=new.codes or known.codes,
        fault=new.fault or known.fault,
    )


def chosen_by(characteristics: Sequence[Characteristic], patterns: Sequence[str]) -> list[Characteristic]:
    """Returns the characteristics whose names match one of the `patterns` (`ACC_*`), all without patterns."""
    result = [
        characteristic
        for characteristic in characteristics
        if not patterns
        or any(characteristic.name == pattern or fnmatchcase(characteristic.name, pattern) for pattern in patterns)
    ]
    if not characteristics:
        raise InvalidInputError(Problem("files", "they have no scalar characteristic", "give a file with some"))
    if not result:
        remedy = nearest(patterns[0], [characteristic.name for characteristic in characteristics])
        raise InvalidInputError(Problem("--match", "no characteristic is left", remedy))
    if len(result) > MOST_PARAMETERS:
        message = f"{len(result):,} characteristics are more than the {MOST_PARAMETERS} parameters of a problem"
        raise InvalidInputError(Problem("--match", message, "choose some by their names, e.g. --match 'ACC_*'"))
    return result


def sections_of(characteristics: Sequence[Characteristic], names: Mapping[str, str], span: float) -> Sections:
    """Returns the sections. `names`: parameters by label, for labels that cannot be names of drivecal; `span`: half the width of a range
    that no file gives, as a share of the value. Raises InvalidInputError with all characteristics that cannot be parameters."""
    result, problems = Sections(), []
    for characteristic in characteristics:
        name = names.get(characteristic.name, characteristic.name)
        if characteristic.fault is not None:
            problems.append(characteristic.fault)
        elif isinstance(characteristic.value, str) and not characteristic.choices:
            result.left_out.append(characteristic.name)
        elif not _NAME.fullmatch(name):
            message = f"{shown(name)} cannot be the name of a parameter"
            problems.append(Problem(shown(characteristic.name), message, "bind it to another name by --names"))
        elif name in result.parameters:
            problems.append(Problem(shown(name), "two characteristics have this name", "change the file of --names"))
        else:
            try:
                result.parameters[name] = entry = _entry(characteristic, span, name, result.guessed)
                if characteristic.value is not None:
                    result.baseline[name] = _value(characteristic, name, entry)
            except InvalidInputError as error:
                problems += error.problems
    if result.left_out and not result.parameters and not problems:
        message = "there are only texts, and no file says what others there are"
        problems.append(Problem(", ".join(map(shown, result.left_out)), message, "give an A2L with their enumerations, too"))
    if problems:
        raise InvalidInputError(*problems)
    return result


def _value(characteristic: Characteristic, name: str, entry: Mapping[str, Any]) -> float | str:
    """Returns a value as a problem has it. Raises InvalidInputError if the parameter cannot have it."""
    value, choices = characteristic.value, characteristic.choices
    if isinstance(value, float) and choices:
        if value not in characteristic.codes:
            raise InvalidInputError(
                Problem(name, f"its value {value:g} is not in its enumeration", f"give {', '.join(choices)}")
            )
        return choices[characteristic.codes.index(value)]
    if isinstance(value, float) and characteristic.integer:
        if not value.is_integer():
            raise InvalidInputError(Problem(name, f"its value {value:g} is not whole", "correct the value, or the A2L"))
        return int(value)
    return _settled(value, entry, name) if isinstance(value, float) else value or ""


def _settled(value: float, entry: Mapping[str, Any], name: str) -> float:
    """Returns a value with nine decimals. A value that equals an end of the range or a step in single precision becomes that end or step.
    Raises InvalidInputError if the decimals change it."""
    lower, upper, step = entry["lower"], entry["upper"], entry.get("step")
    places = [lower, upper] if step is None else [lower + round((value - lower) / step) * step]
    settled = _short(next((place for place in places if math.isclose(value, place, rel_tol=SINGLE)), value))
    if not math.isclose(settled, value, rel_tol=SINGLE, abs_tol=CHANGE * (upper - lower)):
        message = f"its value {value:g} would become {settled:g} with the nine decimals of a parameter"
        raise InvalidInputError(Problem(name, message, "give it in another unit"))
    return settled


def _entry(characteristic: Characteristic, span: float, name: str, guessed: list[str]) -> dict[str, Any]:
    entry: dict[str, Any] = {}
    if characteristic.choices or isinstance(characteristic.value, str):
        if len(characteristic.choices) < 2:
            message = "its enumeration has fewer than two texts"
            raise InvalidInputError(Problem(name, message, "give an A2L with all its texts, or leave it out by --match"))
        entry["choices"] = list(characteristic.choices)
    else:
        lower, upper = characteristic.lower, characteristic.upper
        if lower is None or upper is None or not -LARGEST <= lower < upper <= LARGEST:
            if characteristic.value is None:
                message = "it has neither a usable range nor a value"
                raise InvalidInputError(
                    Problem(name, message, "give a DCM or CDFX with its value, too, or leave it out by --match")
                )
            lower, upper = _guess(characteristic, characteristic.value, span)
            guessed.append(name)
        if characteristic.integer:
            entry |= {"lower": math.ceil(lower), "upper": math.floor(upper), "integer": True}
        else:
            entry |= {"lower": _inwards(lower, 1), "upper": _inwards(upper, -1)}
        if entry["lower"] >= entry["upper"]:
            message = f"its range from {lower:g} to {upper:g} vanishes in the nine decimals of a parameter, or between two whole numbers"
            raise InvalidInputError(Problem(name, message, "give it in another unit, or leave it out by --match"))
        if not characteristic.integer and characteristic.step is not None and name not in guessed:
            entry |= _grid(lower, upper, characteristic.step)
    if characteristic.unit != "1":
        entry["unit"] = characteristic.unit[:32]
    if characteristic.description:
        entry["description"] = characteristic.description[:1000]
    return entry


def _guess(characteristic: Characteristic, value: float, span: float) -> tuple[float, float]:
    """Returns a range around a value, within the limit that the characteristic has on one side."""
    reach = max(span * abs(value) or span, 1.0 if characteristic.integer else 0.0)
    lower, upper = value - reach, value + reach
    ends = characteristic.lower, characteristic.upper
    least, most = (end if end is not None and abs(end) <= LARGEST else None for end in ends)
    within = max(lower, lower if least is None else least), min(upper, upper if most is None else most)
    return within if within[0] < within[1] else (lower, upper)


def _grid(lower: float, upper: float, step: float) -> dict[str, float]:
    """Returns `step`, and the upper end as the last step within the limits; nothing if there is no such grid with nine decimals."""
    count = math.floor((upper - lower) / step + 1e-9)
    if count < 1 or _short(step) != step:
        return {}
    return {"upper": _short(lower + count * step), "step": step}


def _inwards(limit: float, sign: int) -> float:
    """Returns a limit with nine decimals that lies inside the given one, but for single precision. `sign`: 1 for a lower one, else -1."""
    short = _short(limit)
    beyond = sign * (limit - short) > SINGLE * abs(limit)
    return _short(short + sign * 1e-9) if beyond else short


def _short(value: float) -> float:
    """Rounds to the nine decimals that a parameter has."""
    return round(value, 9)
