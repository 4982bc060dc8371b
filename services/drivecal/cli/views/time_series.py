"""Time series as files."""

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from pathlib import Path

from drivecal.contracts.evaluation import SeriesAnswer
from drivecal.contracts.tables import csv_text
from drivecal.domain.errors import InvalidInputError, Problem, file_faults

SUFFIXES = (".csv", ".parquet", ".json")


def save(trace: SeriesAnswer, file: Path) -> None:
    """Writes a table with a row per step (.csv, .parquet), or everything with plans and metrics (.json).

    Raises InvalidInputError if the file cannot be written.
    """
    columns = trace.series
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
                out.write(csv_text([columns, *zip_longest(*columns.values())]))


def _filled(columns: Mapping[str, Sequence[float]]) -> dict[str, list[float | None]]:
    """Returns columns of one length: a simulator's series may have different lengths."""
    longest = max(map(len, columns.values()), default=0)
    return {name: [*values, *[None] * (longest - len(values))] for name, values in columns.items()}
