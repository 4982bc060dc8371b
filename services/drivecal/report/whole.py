"""A whole report: its data and tables, read from a server, and its files."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from drivecal.client.client import Client
from drivecal.contracts.tables import TableName
from drivecal.report.data import ReportData, collect

TABLES: tuple[TableName, ...] = ("generations", "solutions", "optima", "influence")


@dataclass(frozen=True, slots=True)
class Report:
    """The data of a report on a campaign, and its tables: CSV by name, in pieces."""

    data: ReportData
    tables: Mapping[str, Iterable[bytes]]


def read_report(client: Client, identifier: str) -> Report:
    """Reads a report's data; tables are read when they are written.

    Raises NotFoundError for an unknown campaign, ConflictError for a single evaluation, and the client's other exceptions.
    """
    data = collect(client, identifier)
    tables: dict[str, Iterable[bytes]] = {name: client.table(identifier, name, "csv") for name in TABLES}
    if data.robustness:
        tables["robustness"] = client.table(data.robustness[0].study.campaign, "robustness", "csv")
    if data.validation:
        tables["validation"] = client.table(data.validation[0].study.campaign, "validation", "csv")
    return Report(data, tables)


def write(report: Report, folder: Path, *, page_alone: bool = False) -> list[Path]:
    """Writes a report's page, with figures, tables and specification beside it unless `page_alone`. Returns the files, the page last.

    Raises InvalidInputError if a file cannot be written.
    """
    from drivecal.report.writing import write_report  # matplotlib takes a second or two

    return write_report(report.data, report.tables, folder, page_alone=page_alone)
