"""Columns of `contracts.tables` as pyarrow has them, for files and data frames."""

from collections.abc import Sequence
from typing import Any

from drivecal.contracts.tables import Column


def arrow_schema(columns: Sequence[Column]) -> Any:
    """Returns the `pyarrow.Schema` of a file with these columns. Raises ModuleNotFoundError without pyarrow."""
    import pyarrow as pa  # takes a while and memory; most processes never need it

    types = {"integer": pa.int64(), "number": pa.float64(), "text": pa.string(), "truth": pa.bool_()}
    types["numbers"] = pa.list_(pa.float64())
    return pa.schema([(column.name, types[column.kind]) for column in columns])
