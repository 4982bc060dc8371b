"""A whole report: its data and tables, read from a server, and its files."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from drivecal.client.client import Client
from drivecal.contracts.tables import ComparisonTable, TableName
from drivecal.report.data import ComparisonData, ReportData, collect, collect_comparison

TABLES: tuple[TableName, ...] = ("generations", "solutions", "optima", "influence")


@dataclass(frozen=True, slots=True)
class Report:
    """The data of a report on a campaign or a comparison, and its tables: CSV by name, in pieces."""

    data: ReportData | ComparisonData
    tables: Mapping[str, Iterable[bytes]]


def read_report(client: Client, identifier: str) -> Report:
    """Reads a report's data; tables are read when they are written.

    Raises NotFoundError for an unknown campaign, ConflictError for a single evaluation, and the client's other exceptions.
    """
    campaign = client.campaign(identifier)
    if campaign.kind == "comparison":
        names: tuple[ComparisonTable, ...] = get_args(ComparisonTable)
        return Report(collect_comparison(client, campaign), {name: client.table(campaign.id, name, "csv") for name in names})
    data = collect(client, campaign.id)
    tables: dict[str, Iterable[bytes]] = {name: client.table(campaign.id, name, "csv") for name in TABLES}
    if data.robustness:
        tables["robustness"] = client.table(data.robustness[0].study.campaign, "robustness", "csv")
    if data.validation:
        tables["validation"] = client.table(data.validation[0].study.campaign, "validation", "csv")
    return Report(data, tables)


def write(report: Report, folder: Path, *, page_alone: bool = False) -> list[Path]:
    """Writes a report's page, with figures, tables and specification beside it unless `page_alone`. Returns the files, the page last.

    Raises InvalidInputError if a file cannot be written.
    """
    if isinstance(report.data, ComparisonData):
        from drivecal.report.comparison import write_comparison  # matplotlib takes a second or two

        return write_comparison(report.data, report.tables, folder, page_alone=page_alone)
    from drivecal.report.writing import write_report

    return write_report(report.data, report.tables, folder, page_alone=page_alone)
