"""The command that writes a report."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import typer

from drivecal.cli.application import CampaignArgument, JsonOption, UrlOption, app, connect
from drivecal.cli.views.output import print_json
from drivecal.client.client import Client
from drivecal.contracts.tables import ComparisonTable, TableName

if TYPE_CHECKING:
    from drivecal.report.data import ReportData

TABLES: tuple[TableName, ...] = ("generations", "solutions", "optima", "influence")
COMPARISON_TABLES = get_args(ComparisonTable)


@app.command()
def report(
    identifier: CampaignArgument,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="The folder to write to; made if need be.")],
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write a campaign's, or a comparison's, figures (SVG and PNG), tables (CSV) and one self-contained page, index.html."""
    from drivecal.report.comparison import collect_comparison, write_comparison
    from drivecal.report.data import collect
    from drivecal.report.writing import write_report  # matplotlib's second or two, for this command only

    with connect(url) as client:
        campaign = client.campaign(client.full_id(identifier))
        if campaign.kind == "comparison":
            tables = {name: client.table(campaign.id, name, "csv") for name in COMPARISON_TABLES}
            written = write_comparison(collect_comparison(client, campaign), tables, output)
        else:
            diagnostics = collect(client, campaign.id)
            written = write_report(diagnostics, _tables(client, diagnostics), output)
    if as_json:
        print_json({"campaign": campaign.id, "page": str(written[-1]), "files": [str(path) for path in written]})
    else:
        typer.echo(f"{written[-1]}: the report, with {len(written) - 1} files beside it")


def _tables(client: Client, diagnostics: ReportData) -> dict[str, Iterator[bytes]]:
    """Returns the tables of the campaign and of the studies on the page."""
    tables: dict[str, Iterator[bytes]] = {name: client.table(diagnostics.campaign.id, name, "csv") for name in TABLES}
    if diagnostics.robustness:
        tables["robustness"] = client.table(diagnostics.robustness[0].study.campaign, "robustness", "csv")
    if diagnostics.validation:
        tables["validation"] = client.table(diagnostics.validation[0].study.campaign, "validation", "csv")
    return tables
