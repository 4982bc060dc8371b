"""A downloaded table as a data frame of Arrow, pandas or polars."""

from dataclasses import dataclass, field
from importlib import import_module
from io import BytesIO
from typing import Any

from drivecal.contracts.campaign import MOST_ROWS, html_table


@dataclass(frozen=True, slots=True)
class DownloadedTable:
    """All rows of a table with the types of its columns. pandas and polars are optional packages.

    Each method raises ImportError naming the package to install.
    """

    content: bytes = field(repr=False)
    """A Parquet file."""

    def to_arrow(self) -> Any:
        """Returns a `pyarrow.Table`."""
        return _package("pyarrow.parquet").read_table(BytesIO(self.content))

    def to_pandas(self) -> Any:
        """Returns a `pandas.DataFrame`; whole numbers and truth values stay such in columns with missing values."""
        pandas, pyarrow = _package("pandas"), _package("pyarrow")
        types = {pyarrow.int64(): pandas.Int64Dtype(), pyarrow.bool_(): pandas.BooleanDtype()}
        return self.to_arrow().to_pandas(types_mapper=types.get)

    def _repr_html_(self) -> str | None:
        """Returns the first rows as a notebook shows them, None without pyarrow."""
        try:
            table = self.to_arrow()
        except ImportError:
            return None
        note = f"<p>{table.num_rows:,} rows, {table.num_columns} columns</p>"
        return note + html_table(table.slice(0, MOST_ROWS).to_pylist())

    def to_polars(self) -> Any:
        """Returns a `polars.DataFrame`."""
        return _package("polars").read_parquet(BytesIO(self.content))


def _package(name: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        package = name.partition(".")[0]
        raise ImportError(f"this form of a table needs the package {package}: pip install {package}", name=package) from error
