"""Tables as data frames of Arrow, pandas or polars: downloaded files, and rows that are a list as well."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from io import BytesIO
from typing import Any, TypeVar

from pydantic import BaseModel

from drivecal.configuration.arrow import arrow_schema
from drivecal.contracts.campaign import MOST_ROWS, html_table
from drivecal.contracts.tables import Kind, Solution, SolutionPage, columns_of, file_row

RowModel = TypeVar("RowModel", bound=BaseModel)


class Frames(ABC):
    """A table in the forms of other packages, which are optional. Each method raises ImportError naming the package to install."""

    @abstractmethod
    def to_arrow(self) -> Any:
        """Returns a `pyarrow.Table`."""

    def to_pandas(self) -> Any:
        """Returns a `pandas.DataFrame`; whole numbers and truth values stay such in columns with missing values."""
        pandas, pyarrow = _package("pandas"), _package("pyarrow")
        types = {pyarrow.int64(): pandas.Int64Dtype(), pyarrow.bool_(): pandas.BooleanDtype()}
        return self.to_arrow().to_pandas(types_mapper=types.get)

    def to_polars(self) -> Any:
        """Returns a `polars.DataFrame`."""
        return _package("polars").from_arrow(self.to_arrow())


@dataclass(frozen=True, slots=True)
class DownloadedTable(Frames):
    """All rows of a table with the types of its columns."""

    content: bytes = field(repr=False)
    """A Parquet file."""

    def to_arrow(self) -> Any:
        """Returns a `pyarrow.Table`."""
        return _package("pyarrow.parquet").read_table(BytesIO(self.content))

    def to_polars(self) -> Any:
        """Returns a `polars.DataFrame`, without pyarrow."""
        return _package("polars").read_parquet(BytesIO(self.content))

    def _repr_html_(self) -> str | None:
        """Returns the first rows as a notebook shows them, None without pyarrow."""
        try:
            table = self.to_arrow()
        except ImportError:
            return None
        note = f"<p>{table.num_rows:,} rows, {table.num_columns} columns</p>"
        return note + html_table(table.slice(0, MOST_ROWS).to_pylist())


class Rows(list[RowModel], Frames):
    """Rows of a table: a list that notebooks show as a table, in other forms with the columns of the table's files."""

    def __init__(self, model: type[RowModel], rows: Iterable[RowModel]) -> None:
        """`model`: that of each row."""
        super().__init__(rows)
        self._model = model

    def to_arrow(self) -> Any:
        """Returns a `pyarrow.Table`. Without rows it lacks columns of scores, objectives and parameters."""
        _package("pyarrow")
        keys = {name: self._kinds(name) for name in self._model.model_fields}
        from pyarrow import Table

        return Table.from_pylist([file_row(row) for row in self], schema=arrow_schema(columns_of(self._model, keys)))

    def _kinds(self, name: str) -> dict[str, Kind]:
        """Returns the keys of a mapping in all rows with the kinds of their values; nothing for another field."""
        kinds: dict[str, Kind] = {}
        for row in self:
            value = getattr(row, name)
            for key, each in value.items() if isinstance(value, Mapping) else ():
                kind: Kind = "text" if isinstance(each, str) else "integer" if isinstance(each, int) else "number"
                kinds[key] = kind if kinds.get(key, kind) == kind else "number"
        return kinds

    def _repr_html_(self) -> str:
        """Returns the first rows as a table."""
        return html_table([row.model_dump(mode="json") for row in self])


class RankedSets(SolutionPage, Frames):
    """The solutions of a campaign, best first; in other forms with the columns of the table's files."""

    def to_arrow(self) -> Any:
        """Returns a `pyarrow.Table` of the `items`."""
        return Rows(Solution, self.items).to_arrow()


def _package(name: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        package = name.partition(".")[0]
        raise ImportError(f"this form of a table needs the package {package}: pip install {package}", name=package) from error
