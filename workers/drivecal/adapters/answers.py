"""Answers of simulators: JSON of a process or a results file, checked against what the manifest declares."""

import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pydantic import TypeAdapter, ValidationError

from drivecal.contracts.evaluation import ReplayAnswer
from drivecal.contracts.strict_json import unique_keys
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import BusyError, Declared, NoMeasuresError, RunOutcome

MOST_SERIES_VALUES = 1_000_000
"""Limit of the values of all time series of a run."""
_LONGEST_TEXT = 300


def document(content: bytes, source: str) -> dict[str, Any]:
    """Returns the JSON object in `content`. Raises NoMeasuresError. The message names its `source`."""
    try:
        value = json.loads(content, object_pairs_hook=unique_keys)
    except InvalidInputError as error:
        raise _error(f"{source}: {_shown(str(error))}") from None
    except (ValueError, RecursionError):
        hint = "; messages belong on standard error" if source == "the answer" else ""
        raise _error(f"{source} is not JSON: {_shown(content)}{hint}") from None
    if not isinstance(value, dict):
        raise _error(f"{source} is not a JSON object: {_shown(content)}")
    return value


def outcome(answer: Mapping[str, Any], declared: Declared, *, series: bool, replay: bool = False) -> RunOutcome:
    """Returns the outcome that an answer reports. Raises NoMeasuresError if it reports an error or breaks the declaration, and BusyError if
    the simulator takes no run for now.

    Answers may hold a replay next to their series if `replay` is true; other simulators report none.
    A failed run may have no, empty or infinite numbers: those measures are left out, and series with such values.
    """
    refuse_busy(answer)
    if answer.get("error") not in (None, False, ""):
        raise _error(f"the simulator reports: {_shown(str(answer['error']))}")
    failure, reported, recorded = answer.get("failure"), answer.get("measures"), answer.get("series", {})
    if failure is not None:
        _check_failure(failure, declared)
        reported = _kept({} if reported is None else reported, _has_value)
        recorded = _kept({} if recorded is None else recorded, _has_values)
    if not isinstance(reported, dict):
        raise _error("the answer has no object `measures`")
    measures = {name: _number(name, value) for name, value in reported.items()}
    if undeclared := sorted(measures.keys() - set(declared.measures)):
        raise _error(f"measures that are not declared: {_joined(undeclared)}; declared: {_joined(declared.measures)}")
    if failure is None and (missing := [name for name in declared.measures if name not in measures]):
        raise _error(f"the answer lacks measures: {_joined(missing)}; give all that problem.yaml declares, or a `failure`")
    if not series:
        return RunOutcome(measures, failure)
    return RunOutcome(measures, failure, _series(recorded, declared), replay=_replay(answer) if replay else None)


def refuse_busy(answer: Mapping[str, Any]) -> None:
    """Raises BusyError if an answer says why the simulator takes no run for now."""
    if answer.get("busy") not in (None, False, ""):
        raise BusyError(_shown(str(answer["busy"])))


def _kept(reported: object, has_value: Callable[[object], bool]) -> object:
    """Returns what a failed run reports, without entries that have no value."""
    if not isinstance(reported, dict):
        return reported
    return {name: value for name, value in reported.items() if has_value(value)}


def _has_value(value: object) -> bool:
    return value is not None and (not isinstance(value, (int, float)) or abs(value) <= sys.float_info.max)


def _has_values(values: object) -> bool:
    return not isinstance(values, list) or all(map(_has_value, values))


def _check_failure(failure: object, declared: Declared) -> None:
    if not isinstance(failure, str) or not 0 < len(failure) <= 64 or not failure.isprintable():
        raise _error("`failure` is not the name of a failure, i.e. a text of 1 to 64 characters")
    if failure in set(Breakdown):
        raise _error(f"{failure} means that a run has no result; give a failure of the system under test another name")
    if declared.failures and failure not in declared.failures:
        raise _error(f"a failure that problem.yaml does not declare: {failure}; declared: {_joined(declared.failures)}")


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise _error(f"{_shown(name)} is not a number: {_shown(repr(value))}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise _error(f"{_shown(name)} is not finite: {number}; give a number, or a `failure` if the system under test failed")
    return number


def _series(reported: object, declared: Declared) -> dict[str, list[float]]:
    if not isinstance(reported, dict) or not all(isinstance(values, list) for values in reported.values()):
        raise _error("`series` is not an object of lists of numbers")
    if undeclared := sorted(reported.keys() - set(declared.series)):
        raise _error(f"time series that problem.yaml does not declare: {_joined(undeclared)}")
    if sum(map(len, reported.values())) > MOST_SERIES_VALUES:
        raise _error(f"the time series have more than {MOST_SERIES_VALUES:,} values")
    return {name: [_number(name, value) for value in values] for name, values in reported.items()}


def _replay(answer: Mapping[str, Any]) -> ReplayAnswer | None:
    """Returns the replay, which a page draws: a controller of the user's runs in the process that reports it."""
    try:
        return TypeAdapter(ReplayAnswer | None).validate_python(answer.get("replay"))
    except ValidationError as error:
        raise _error(f"the replay cannot be read: {_shown(str(error))}") from None


def _error(detail: str) -> NoMeasuresError:
    return NoMeasuresError(Breakdown.ERROR, detail)


def _joined(names: Sequence[str]) -> str:
    shown = ", ".join(_shown(name) for name in names[:5])
    return f"{shown} and {len(names) - 5} more" if len(names) > 5 else shown


def _shown(content: bytes | str) -> str:
    """Returns the start of foreign text, printable."""
    text = content[: 4 * _LONGEST_TEXT].decode(errors="replace") if isinstance(content, bytes) else content
    text = " ".join(text.split())
    shortened = text if len(text) <= _LONGEST_TEXT else text[: _LONGEST_TEXT - 1] + "…"
    return "".join(character if character.isprintable() else "?" for character in shortened)
