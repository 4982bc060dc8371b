"""The `parameters` and `baseline` sections of a problem, from characteristics of files."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from fnmatch import fnmatchcase
from itertools import pairwise
from typing import Any

from drivecal.bundles import units
from drivecal.calibration_data.characteristics import Axis, Characteristic, index
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem

LARGEST = 1e6
"""Largest number that a parameter of drivecal may have."""
MOST_PARAMETERS = 200
FEW = 8
"""Coefficients of a curve or map with more points than a problem has parameters."""
AXES = "xy"
SINGLE = 2.0**-23
"""Relative precision of a number of 32 bits."""
CHANGE = 1e-6
"""Largest change of a value that is written with nine decimals, as a share of its range."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]{0,63}")


@dataclass(slots=True)
class Sections:
    """`parameters` and `baseline`, ready for `problem.yaml`. `guessed`: parameters whose range is only a span around their value.
    `left_out`: why others are missing, by name: texts whose choices no file has, as in a DCM without its A2L, and curves without axes."""

    parameters: dict[str, dict[str, Any]] = field(default_factory=dict)
    baseline: dict[str, Any] = field(default_factory=dict)
    guessed: list[str] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)


def joined(files: Iterable[Sequence[Characteristic]]) -> list[Characteristic]:
    """Returns the characteristics of several files by name: what a later file does not say, an earlier one may, e.g. limits of an A2L for
    the values of a DCM. Curves get the points of their shared axes."""
    result: dict[str, Characteristic] = {}
    for characteristics in files:
        for new in characteristics:
            known = result.get(new.name)
            result[new.name] = new if known is None else _joined(known, new)
    for name, each in result.items():
        axes = []
        for axis in each.axes:
            own = result.get(axis.shared) if axis.kind == "COM_AXIS" and not axis.points else None
            axes.append(replace(axis, points=own.values, unit=own.unit if axis.unit == "1" else axis.unit) if own else axis)
        result[name] = whole = replace(each, axes=tuple(axes))
        if each.values and all(axis.points for axis in axes) and whole.given is None and whole.fault is None:
            message = f"it has {len(each.values)} values, and {' x '.join(str(len(axis.points)) for axis in axes)} points"
            result[name] = replace(whole, fault=Problem(shown(name), message, "give files of one version"))
    return list(result.values())


def axis_points(characteristics: Iterable[Characteristic]) -> list[Characteristic]:
    """Returns the known points of axes that are not shared as characteristics of their own, `gain.x` for the first axis of `gain`."""
    return [
        Characteristic(
            f"{each.name}.{letter}", unit=axis.unit, lower=axis.lower, upper=axis.upper, line=each.line, kind="COM_AXIS",
            description=f"axis {letter} of {each.name}", axes=(index(len(axis.points)),), values=axis.points,
        )
        for each in characteristics
        for letter, axis in zip(AXES, each.axes, strict=False)
        if axis.kind == "STD_AXIS" and axis.points
    ]  # fmt: skip


def _joined(known: Characteristic, new: Characteristic) -> Characteristic:
    if len(known.axes) != len(new.axes):
        message = f"it has {len(known.axes)} axes in a file, and {len(new.axes)} in another"
        new = replace(new, fault=Problem(shown(new.name), message, "give files of one version, or leave it out by --match"))
    if units.agree(known.unit, new.unit) is False:
        message = f"it is in {known.unit} in a file, and in {new.unit} in another"
        new = replace(
            new, fault=new.fault or Problem(shown(new.name), message, "give files in one unit, or leave it out by --match")
        )
    axes = []
    for old, axis in zip(known.axes, new.axes, strict=False):
        points = axis.points if axis.points and (new.values or not old.points) else old.points
        kind = axis.kind if old.kind == "STD_AXIS" else old.kind  # a DCM does not have the kind of each axis
        axes.append(replace(old, **_said(axis) | {"points": points, "kind": kind}))
    return replace(known, **_said(new) | {"axes": tuple(axes)})


def _said(given: Axis | Characteristic) -> dict[str, Any]:
    """Returns what a file says: the fields that do not have their defaults."""
    return {each.name: value for each in fields(given) if (value := getattr(given, each.name)) != each.default}


def chosen_by(characteristics: Sequence[Characteristic], patterns: Sequence[str]) -> list[Characteristic]:
    """Returns the characteristics whose names match one of the `patterns` (`ACC_*`), all without patterns."""
    result = [
        characteristic
        for characteristic in characteristics
        if not patterns
        or any(characteristic.name == pattern or fnmatchcase(characteristic.name, pattern) for pattern in patterns)
    ]
    if not characteristics:
        raise InvalidInputError(Problem("files", "no characteristic can be a parameter", "give a file with some"))
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
        elif (reason := _missing(characteristic)) is not None:
            result.left_out[characteristic.name] = reason
        elif not _NAME.fullmatch(name):
            message = f"{shown(name)} cannot be the name of a parameter"
            problems.append(Problem(shown(characteristic.name), message, "bind it to another name by --names"))
        elif name in result.parameters:
            problems.append(Problem(shown(name), "two characteristics have this name", "change the file of --names"))
        else:
            try:
                result.parameters[name] = entry = _entry(characteristic, span, name, result.guessed)
                if characteristic.values:
                    settled = tuple(_settled(value, entry, name) for value in characteristic.values)
                    result.baseline[name] = replace(characteristic, values=settled).given
                elif characteristic.value is not None:
                    result.baseline[name] = _value(characteristic, name, entry)
            except InvalidInputError as error:
                problems += error.problems
    if result.left_out and not result.parameters and not problems:
        problems += [Problem(shown(name), why, "give a file that has it, too") for name, why in result.left_out.items()]
    if problems:
        raise InvalidInputError(*problems)
    return result


def _missing(characteristic: Characteristic) -> str | None:
    """Returns why a characteristic cannot be a parameter, though it has no fault."""
    if isinstance(characteristic.value, str) and not characteristic.choices:
        return "it is a text, and no file says what others there are (an A2L with its enumeration does)"
    if characteristic.axes and characteristic.choices:
        return "its values are texts"
    for letter, axis in zip(AXES, characteristic.axes, strict=False):
        if not axis.points:
            why = "which needs a linear conversion" if axis.kind == "FIX_AXIS" else "which an A2L leaves to the memory"
            named = f"its axis {letter} ({axis.shared or axis.kind})"
            return f"no file has the points of {named}, {why}: give a DCM or CDFX, too"
        if len(axis.points) < 2 or any(not low < high for low, high in pairwise(axis.points)):
            return f"the points of its axis {letter} do not rise"
    return None


def _value(characteristic: Characteristic, name: str, entry: Mapping[str, Any]) -> float | str:
    """Returns a value as a problem has it. Raises InvalidInputError if the parameter cannot have it."""
    value, choices = characteristic.value, characteristic.choices
    if isinstance(value, float) and choices:
        if value not in characteristic.codes:
            raise InvalidInputError(Problem(name, f"its value {value:g} is not enumerated", f"give {', '.join(choices)}"))
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
    entry: dict[str, Any] = _axes(characteristic)
    if characteristic.choices or isinstance(characteristic.value, str):
        if len(characteristic.choices) < 2:
            message = "its enumeration has fewer than two texts"
            raise InvalidInputError(Problem(name, message, "give an A2L with all its texts, or leave it out by --match"))
        entry["choices"] = list(characteristic.choices)
    else:
        lower, upper = characteristic.lower, characteristic.upper
        if lower is None or upper is None or not -LARGEST <= lower < upper <= LARGEST:
            values = characteristic.values or ((characteristic.value,) if characteristic.value is not None else ())
            if not values:
                message = "it has neither a usable range nor a value"
                raise InvalidInputError(Problem(name, message, "give a DCM or CDFX with its value, or leave it out by --match"))
            lower, upper = _guess(characteristic, values, span)
            guessed.append(name)
        if characteristic.integer:
            whole = {"step": 1} if characteristic.axes else {"integer": True}
            entry |= {"lower": math.ceil(lower), "upper": math.floor(upper), **whole}
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


def _axes(characteristic: Characteristic) -> dict[str, Any]:
    """Returns the entry's fields on the axes of a curve or map; no fields for a value."""
    axes, entry = characteristic.axes, dict[str, Any]()
    if len(axes) == 1:
        entry["curve"] = {"axis": list(axes[0].points)}
        entry["curve"] |= {"axis_unit": axes[0].unit[:32]} if axes[0].unit != "1" else {}
    elif axes:
        entry["map"] = {letter: list(axis.points) for letter, axis in zip(AXES, axes, strict=True)}
        entry["map"] |= {f"{letter}_unit": axis.unit[:32] for letter, axis in zip(AXES, axes, strict=True) if axis.unit != "1"}
    if math.prod(len(axis.points) for axis in axes) > MOST_PARAMETERS:
        entry["coefficients"] = FEW
    return entry | ({"monotone": "increasing"} if characteristic.kind == "COM_AXIS" else {})


def _guess(characteristic: Characteristic, values: Sequence[float], span: float) -> tuple[float, float]:
    """Returns a range around values, within the limit that the characteristic has on one side."""
    reach = max(span * max(map(abs, values)) or span, 1.0 if characteristic.integer else 0.0)
    lower, upper = min(values) - reach, max(values) + reach
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
