"""The command that compares optimizers and reductions."""

from typing import Annotated

import typer

from drivecal.cli.application import ExitCode, app, code_of_state, say
from drivecal.cli.commands.campaigns import DryRunOption, TimeoutOption, refuse_ignored
from drivecal.cli.views.output import Asked, asking, print_columns, print_pace
from drivecal.cli.views.progress import attached, pauses
from drivecal.cli.views.sections import fixed, objective_number
from drivecal.client.client import Client
from drivecal.configuration.documents import opened_document
from drivecal.contracts.comparison import ComparedGroup, Comparison, ExpectedComparison
from drivecal.domain.campaigns import CampaignState

SECONDS_BETWEEN_LOOKS = 2.0


@app.command("compare-optimizers")
@asking
def compare_optimizers(
    client: Client,
    file: Annotated[str | None, typer.Argument(metavar="FILE", help="A comparison, YAML or JSON; - is standard input.")] = None,
    tag: Annotated[str | None, typer.Option(metavar="TAG", help="Compare the campaigns with this tag instead.")] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Wait until all campaigns have ended.")] = False,
    timeout: TimeoutOption = None,
    dry_run: DryRunOption = False,
) -> Asked:
    """Calibrate one problem with several optimizers, populations, seeds and reductions, and compare the results."""
    if (file is None) == (tag is None):
        raise typer.BadParameter("give a FILE, or --tag TAG of campaigns that are there")
    if dry_run and file is None:
        raise typer.BadParameter("--dry-run needs a FILE")
    refuse_ignored(wait, timeout, dry_run=dry_run)
    if file is None:
        comparison = client.comparison(tag or "")
    else:
        with opened_document(file) as specification:
            if dry_run:
                expected = client.expected_comparison(specification)
                return expected, lambda: _print_expected(expected)
            comparison = client.compare(specification)
        say(f"{len(comparison.runs)} campaigns are queued; see `drivecal compare-optimizers --tag {comparison.tag}`")
    if wait:
        comparison = _wait_for(client, comparison, timeout)
    codes = {code_of_state(run.state) for run in comparison.runs if wait} - {ExitCode.OK}
    # failed campaigns count before cancelled ones
    return comparison, lambda: _print_comparison(comparison), min(codes, default=ExitCode.OK)


def _wait_for(client: Client, comparison: Comparison, timeout: float | None) -> Comparison:
    """Reports the number of ended campaigns until all have ended. Raises WaitTimedOutError after `timeout` seconds."""
    asking, ended = pauses(SECONDS_BETWEEN_LOOKS, timeout), -1
    with attached(f"the campaigns go on; `drivecal cancel --tag {comparison.tag}` ends them", timeout):
        while True:
            if ended != (ended := sum(CampaignState(run.state).ended for run in comparison.runs)):
                say(f"{ended} of {len(comparison.runs)} campaigns have ended")
            if ended == len(comparison.runs):
                return comparison
            next(asking)
            comparison = client.comparison(comparison.tag)


def _print_comparison(comparison: Comparison) -> None:
    """Prints Table 5 of the paper for these campaigns."""
    ended = sum(CampaignState(run.state).ended for run in comparison.runs)
    typer.echo(f"tag {comparison.tag}: {len(comparison.runs)} campaigns, {ended} of them have ended")
    for run in comparison.runs:
        if run.state in {CampaignState.FAILED, CampaignState.CANCELLED}:
            typer.echo(f"{run.state}: {run.name} ({run.campaign})")
    several = len({group.reduction for group in comparison.groups}) > 1
    header = ["optimizer", "population", *(["reduction"] if several else []), "best", "mean", "worst", "rating", "sets at best"]
    header += ["simulations", "converged", "iterations", "simulations until then", "as good as any"]
    header += [f"after {mark:,}" for mark in comparison.groups[0].after] if comparison.groups else []
    print_columns(header, [_group_row(group, several) for group in comparison.groups])
    has_marks = any(group.after for group in comparison.groups)
    typer.echo(
        "Over the seeds. Simulations are those that each campaign needs alone; it has converged when its best stays for 10 iterations."
        + (" `after N`: the mean best objective at equal simulations." if has_marks else "")
    )
    if several:
        typer.echo("Objectives are of sets that were simulated whole: a search prefers sets that references make too good.")


def _group_row(group: ComparedGroup, with_reduction: bool) -> list[object]:
    good = None if group.successes is None else f"{group.successes} of {group.seeds}"
    return [
        *(group.optimizer, group.population or "-", *([group.reduction] if with_reduction else [])),
        *(objective_number(value) for value in (group.best, group.mean, group.minimum)),
        *(fixed(group.rating, 3), fixed(group.alternatives, 1, ","), fixed(group.simulations, 0, ",")),
        *(f"{group.converged} of {group.seeds}", fixed(group.iterations_to_converge, 1, ",")),
        *(fixed(group.simulations_to_converge, 0, ","), good),
        *(objective_number(value) for value in group.after.values()),
    ]


def _print_expected(expected: ExpectedComparison) -> None:
    typer.echo(f"the comparison can run: {expected.runs:,} campaigns propose {expected.proposed:,} cells")
    typer.echo(f"and simulate at most {expected.at_most:,}; what they have in common, such as their start, is simulated once")
    print_pace(expected)
