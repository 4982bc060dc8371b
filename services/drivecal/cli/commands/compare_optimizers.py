"""The command that compares optimizers and reductions."""

from typing import Annotated

import typer

from drivecal.cli.application import JsonOption, UrlOption, app, connect
from drivecal.cli.commands.campaigns import DryRunOption, TimeoutOption, WaitOption, submitted
from drivecal.cli.views.comparisons import print_expected
from drivecal.cli.views.output import print_answer
from drivecal.client.documents import opened_document


@app.command("compare-optimizers")
def compare_optimizers(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A comparison file, YAML or JSON; - is standard input.")],
    wait: WaitOption = False,
    timeout: TimeoutOption = None,
    dry_run: DryRunOption = False,
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Calibrate one problem with several optimizers, populations, seeds and reductions, and compare the results."""
    with connect(url) as client, opened_document(file) as specification:
        if dry_run:
            print_answer(client.expected_comparison(specification), as_json, print_expected)
        else:
            submitted(client, client.compare(specification), wait, timeout, as_json)
