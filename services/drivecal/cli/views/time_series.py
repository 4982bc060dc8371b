"""Time series as files: tables, and measurement files of calibration tools, MF4 (ASAM MDF 4.1), by asammdf (extra `mf4`)."""

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib import import_module
from itertools import pairwise, zip_longest
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from drivecal.contracts.evaluation import SeriesAnswer, TraceAnswer
from drivecal.domain.errors import InvalidInputError, Problem, file_faults
from drivecal.domain.scales import told

VERSION = "4.10"
TIMES = ("time", "time_s", "t", "t_s")
"""Names of the time among the series of a simulator."""
BY_INDEX = 4
"""Synchronisation of a channel group without time, as MDF numbers it."""
SI_UNITS = {"m": "m", "s": "s", "mps": "m/s", "mps2": "m/s^2", "mps3": "m/s^3", "rad": "rad", "radps": "rad/s"}
"""Units by the last part of a name, in traces that name them so."""
_UNPRINTABLE = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True, slots=True)
class RecordedScenario:
    """The time series of a run in a scenario. `facts` stand in the file; `units` are the units of a bundle's series, by name."""

    scenario: str
    trace: TraceAnswer | SeriesAnswer
    facts: Mapping[str, str]
    units: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class _Group:
    """Channels of one length; without times they are numbered by their steps."""

    times: Sequence[float] | None
    columns: Mapping[str, Sequence[float]]


def require_library() -> None:
    """Raises ModuleNotFoundError without asammdf: before a server simulates anything for a file that cannot be written."""
    import_module("asammdf")


def measurement(recordings: Sequence[RecordedScenario], facts: Mapping[str, str], begun: datetime | None) -> bytes:
    """Returns a file with a channel group for each scenario, and one for series of another length than its time.

    `facts` are about all runs; `begun` is the start of measurement. Raises ModuleNotFoundError without asammdf.
    """
    from asammdf import MDF, Signal

    with MDF(version=VERSION) as file:
        if begun is not None:
            file.header.start_time = begun
        file.header.comment = _comment("HDcomment", "Time series of drivecal", facts)
        for recording in recordings:
            for number, group in enumerate(_groups(recording.trace)):
                name = recording.scenario if number == 0 else f"{recording.scenario}, series {number + 1}"
                timed: dict[str, Any] = {} if group.times is not None else {"master_metadata": ("step", BY_INDEX)}
                signals = [
                    Signal(
                        np.asarray(values, dtype=np.float64),
                        np.asarray(range(len(values)) if group.times is None else group.times, dtype=np.float64),
                        unit=_unit(column, recording),
                        name=column,
                        comment=f"scenario {recording.scenario}",
                        **timed,
                    )
                    for column, values in group.columns.items()
                ]
                file.append(signals, acq_name=name, comment=_comment("CGcomment", recording.scenario, recording.facts))
        buffer = io.BytesIO()
        file.save(buffer)
    return buffer.getvalue()


def run_facts(score: float | None, failure: str | None) -> dict[str, str]:
    """Returns the facts of a run."""
    known = {"score": told(score), "failure": failure or ""}
    return {name: text for name, text in known.items() if text}


def _groups(trace: TraceAnswer | SeriesAnswer) -> Iterator[_Group]:
    if isinstance(trace, TraceAnswer):
        neighbours = {
            f"{vehicle}_{name}": values for vehicle, series in trace.neighbours.items() for name, values in series.items()
        }
        yield _Group(trace.time_s, trace.ego | neighbours)
        return
    series = {name: values for name, values in trace.series.items() if values}
    time = next((name for name in TIMES if name in series and _is_time(series[name])), None)
    by_length: dict[int, dict[str, Sequence[float]]] = {}
    for name, values in series.items():
        if name != time:
            by_length.setdefault(len(values), {})[name] = values
    times = None if time is None else series[time]
    if times is not None and len(times) in by_length:
        yield _Group(times, by_length.pop(len(times)))
    for columns in by_length.values():
        yield _Group(None, columns)


def _is_time(values: Sequence[float]) -> bool:
    return len(values) > 1 and all(before <= after for before, after in pairwise(values))


def _unit(name: str, recording: RecordedScenario) -> str:
    if isinstance(recording.trace, TraceAnswer):
        return SI_UNITS.get(name.rpartition("_")[2], "")
    unit = recording.units.get(name, "")
    return "" if unit == "1" else unit


def _comment(tag: str, text: str, facts: Mapping[str, str]) -> str:
    """Returns a comment of MDF: a text, and properties by name."""
    properties = "".join(f"<e name={quoteattr(_clean(name))}>{escape(_clean(value))}</e>" for name, value in facts.items())
    return f"<{tag}><TX>{escape(_clean(text))}</TX><common_properties>{properties}</common_properties></{tag}>"


def _clean(text: str) -> str:
    return _UNPRINTABLE.sub("\N{REPLACEMENT CHARACTER}", text)


MEASUREMENT = ".mf4"
SUFFIXES = (".csv", ".parquet", ".json")


def columns_of(trace: TraceAnswer | SeriesAnswer) -> dict[str, list[float]]:
    """Returns columns with a value per step: time, ego vehicle, and neighbours with their names in front; of a bundle all of its series."""
    if isinstance(trace, SeriesAnswer):
        return dict(trace.series)
    columns = {"time_s": trace.time_s, **trace.ego}
    for vehicle, series in trace.neighbours.items():
        columns |= {f"{vehicle}_{name}": values for name, values in series.items()}
    return columns


def save(trace: TraceAnswer | SeriesAnswer, file: Path) -> None:
    """Writes a table with a row per step (.csv, .parquet), or everything with plans and metrics (.json).

    Raises InvalidInputError if the file cannot be written.
    """
    columns = columns_of(trace)
    if not columns:
        raise InvalidInputError(Problem("--trace", "the run has no time series", "declare some under `series` in problem.yaml"))
    with file_faults(file, "written", "give another file"):
        if file.suffix == ".json":
            file.write_text(trace.model_dump_json(indent=1), encoding="utf-8")
        elif file.suffix == ".parquet":
            import pyarrow as pa  # not installed with the client alone
            import pyarrow.parquet as pq

            pq.write_table(pa.table(_filled(columns)), file)
        else:
            with file.open("w", newline="", encoding="utf-8") as out:
                csv.writer(out).writerows([columns, *zip_longest(*columns.values())])


def _filled(columns: Mapping[str, Sequence[float]]) -> dict[str, list[float | None]]:
    """Returns columns of one length: a simulator's series may have different lengths."""
    longest = max(map(len, columns.values()), default=0)
    return {name: [*values, *[None] * (longest - len(values))] for name, values in columns.items()}
