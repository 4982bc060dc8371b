"""Commands about campaigns as a whole."""

from collections.abc import Callable, Iterable, Sequence
from typing import Annotated, TypeVar, get_args

import typer

from drivecal.cli.application import COMMANDS, CampaignArgument, ExitCode, app, code_of_state, complain, exit_code, say
from drivecal.cli.views.output import (
    Asked,
    Show,
    asking,
    print_campaign,
    print_evaluation,
    print_pace,
    print_page,
    print_results,
    saved,
    when,
)
from drivecal.cli.views.progress import follow
from drivecal.cli.views.sections import judged_text, percent
from drivecal.client.client import Action, Client
from drivecal.configuration.documents import opened_document
from drivecal.contracts.assignments import assignments
from drivecal.contracts.campaign import STUDIES, Campaign, CellCounts, ExpectedRuns
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import ConflictError, DrivecalError, NotAuthorisedError, NotFoundError

Answered = TypeVar("Answered")
WaitOption = Annotated[bool, typer.Option("--wait", help="Show the progress until the campaign has ended.")]
TimeoutOption = Annotated[float | None, typer.Option(min=0, help="Seconds to wait at most; exit status 6 when they are over.")]

TagOption = Annotated[str | None, typer.Option(metavar="TAG", help="All campaigns with this tag, in the place of an ID.")]
MaybeCampaign = Annotated[str | None, typer.Argument(metavar="ID", help="The id, or at least its first four characters.")]
PAGE = 1_000
"""Campaigns that one answer of the server lists."""
DryRunOption = Annotated[bool, typer.Option("--dry-run", help="Check the file and count the runs, submit nothing.")]


@app.command()
@asking
def submit(
    client: Client,
    file: Annotated[str, typer.Argument(metavar="FILE", help="A campaign file, YAML or JSON; - is standard input.")],
    wait: WaitOption = False,
    timeout: TimeoutOption = None,
    dry_run: DryRunOption = False,
) -> Asked:
    """Submit a campaign."""
    refuse_ignored(wait, timeout, dry_run=dry_run)
    with opened_document(file) as specification:
        if not dry_run:
            return submitted(client, client.submit(specification), wait, timeout)
        expected = client.expected_runs(specification)
        return expected, lambda: _print_expected(expected)


@app.command()
@asking
def rerun(
    client: Client,
    identifier: CampaignArgument,
    weights: Annotated[
        str | None, typer.Option(metavar="S1=2,S2=1", help="The new weights; a scenario that is not named has weight 1.")
    ] = None,
    evaluator: Annotated[
        str | None,
        typer.Option(help="Another score: one of the problem's, reference, learned or a plug-in; it rates stored runs."),
    ] = None,
    problem: Annotated[str | None, typer.Option(help="Another push of the problem, e.g. with another formula.")] = None,
    budget: Annotated[int | None, typer.Option(min=1, metavar="N", help="Simulations (surrogate: and stored answers).")] = None,
    name: Annotated[str | None, typer.Option(help="A name for the rerun.")] = None,
    wait: WaitOption = False,
    timeout: TimeoutOption = None,
) -> Asked:
    """Run an ended campaign again with other weights or another evaluator, on the stored results."""
    if weights is None and evaluator is None and problem is None and budget is None:
        raise typer.BadParameter("say what changes: --weights, --evaluator, --problem or --budget")
    refuse_ignored(wait, timeout)
    given = {"name": name, "evaluator": evaluator, "problem": problem}
    changes: dict[str, object] = {key: value for key, value in given.items() if value is not None}
    first = client.campaign(identifier)
    spec = first.spec
    changes["weights"] = spec.get("weights", {}) if weights is None else assignments(weights.split(","), "--weights")
    if budget is not None:  # its other ends stay
        changes["budget"] = {**(spec.get("budget") or {}), "simulations": budget}
    return submitted(client, client.rerun(first.id, changes), wait, timeout)


@app.command("list")
@asking
def list_campaigns(
    client: Client,
    state: Annotated[CampaignState | None, typer.Option(help="Only campaigns in this state.")] = None,
    tags: Annotated[list[str] | None, typer.Option("--tag", help="Only campaigns with this tag; repeated: with all.")] = None,
    limit: Annotated[int, typer.Option(min=1, max=1000, help="How many at most, newest first.")] = 20,
) -> Asked:
    """List campaigns, newest first."""
    page = client.campaigns(state=state, limit=limit, tags=tags or ())
    header = ["id", "state", "kind", "created", "requested", "simulated", "saved", "best", "owner", "tags", "name"]
    return page, lambda: print_page(page, header, [_row(campaign) for campaign in page.items], limit)


@app.command()
@asking
def show(client: Client, identifier: CampaignArgument) -> Asked:
    """Show one campaign, or a single evaluation by its whole id."""
    return _whole(client, client.campaign(identifier))


@app.command()
@asking
def watch(client: Client, identifier: CampaignArgument, timeout: TimeoutOption = None) -> Asked:
    """Follow a campaign until it has ended. Ctrl-C detaches and cancels nothing."""
    campaign = follow(client, client.campaign(identifier).id, timeout, from_beginning=False)
    return *_whole(client, campaign), code_of_state(campaign.state)


def _steering(action: Action) -> None:
    """Adds the command that asks for an action."""

    @app.command(action, help=COMMANDS[action][1])
    @asking
    def steer(client: Client, identifier: MaybeCampaign = None, tag: TagOption = None) -> Asked:
        chosen = _chosen(client, identifier, tag)
        if identifier is not None:
            return _whole(client, client.act(chosen[0].id, action))
        open_ones = [campaign.id for campaign in chosen if not CampaignState(campaign.state).ended]
        changed, refused = _each(open_ones, lambda campaign: client.act(campaign, action))
        ended = len(chosen) - len(open_ones)
        say(f"asked {len(changed)} of {len(chosen)} campaigns to {action}; {ended} have ended, {len(refused)} refuse")
        return list(changed.values()), lambda: None, _code_of(refused)


for _action in get_args(Action):
    _steering(_action)


@app.command()
@asking
def label(
    client: Client,
    identifier: CampaignArgument,
    name: Annotated[str | None, typer.Option(help="Another name.")] = None,
    tags: Annotated[list[str] | None, typer.Option("--tag", metavar="TAG", help="Add a tag; may be repeated.")] = None,
    untag: Annotated[list[str] | None, typer.Option(metavar="TAG", help="Take a tag away; may be repeated.")] = None,
) -> Asked:
    """Change a campaign's name or tags."""
    if not (name or tags or untag):
        raise typer.BadParameter("say what changes: --name, --tag or --untag")
    it = client.label(identifier, name=name, add_tags=tags, remove_tags=untag)
    return it, lambda: typer.echo(f"campaign {it.id}  {it.name}\ntags     {' '.join(it.tags) or '-'}")


@app.command()
@asking
def delete(client: Client, identifier: MaybeCampaign = None, tag: TagOption = None) -> Asked:
    """Delete an ended campaign to which no other refers. What it simulated stays in the reference table."""
    deleted, refused = _each([campaign.id for campaign in _chosen(client, identifier, tag)], client.delete)
    text = "".join(f"campaign {campaign} is deleted; what it simulated stays in the reference table\n" for campaign in deleted)
    return {"deleted": list(deleted)}, lambda: typer.echo(text, nl=False), _code_of(refused)


def _each(chosen: Iterable[str], call: Callable[[str], Answered]) -> tuple[dict[str, Answered], list[DrivecalError]]:
    """Calls something about each of some campaigns. Returns the answers by id, and the refusals: they keep no other from being asked."""
    answers: dict[str, Answered] = {}
    refused: list[DrivecalError] = []
    for campaign in chosen:
        try:
            answers[campaign] = call(campaign)
        except (ConflictError, NotAuthorisedError, NotFoundError) as error:
            refused.append(error)
    return answers, refused


def _code_of(refused: Sequence[DrivecalError]) -> ExitCode:
    """Says all refusals, and returns the exit status of the first."""
    for error in refused:
        complain(error)
    return exit_code(refused[0]) if refused else ExitCode.OK


def _chosen(client: Client, identifier: str | None, tag: str | None) -> list[Campaign]:
    """Returns a campaign, or those with a tag."""
    if (identifier is None) == (tag is None):
        raise typer.BadParameter("give a campaign's ID, or --tag TAG of several")
    if identifier is not None:
        return [client.campaign(identifier)]
    chosen, page = list[Campaign](), None
    while page is None or page.next_cursor is not None:
        page = client.campaigns(limit=PAGE, tags=[tag or ""], cursor=page.next_cursor if page else None)
        chosen += page.items
    if not chosen:
        raise NotFoundError("campaign with the tag", tag or "")
    return chosen


def refuse_ignored(wait: bool, timeout: float | None, *, dry_run: bool = False) -> None:
    """Raises BadParameter for an option that would have no effect."""
    if dry_run and (wait or timeout is not None):
        raise typer.BadParameter("--dry-run submits nothing: leave --wait and --timeout out")
    if timeout is not None and not wait:
        raise typer.BadParameter("--timeout needs --wait")


def submitted(client: Client, campaign: Campaign, wait: bool, timeout: float | None) -> Asked:
    """Returns a new campaign, with `wait` at its end and with the matching exit status."""
    if wait:
        say(f"campaign {campaign.id} is queued")
        campaign = follow(client, campaign.id, timeout)
        return *_whole(client, campaign), code_of_state(campaign.state)
    say(f"queued; follow it with `drivecal watch {campaign.id}`")
    return _whole(client, campaign)


def _whole(client: Client, campaign: Campaign) -> tuple[object, Show]:
    """Returns a campaign with its results; a single evaluation as `evaluate` does."""
    if campaign.kind == "evaluation":
        evaluation = client.evaluation(campaign.id)
        return evaluation, lambda: print_evaluation(evaluation, client.problem(campaign.spec["problem"]).shapes)
    results = client.results(campaign.id)

    def show() -> None:
        print_campaign(campaign)
        print_results(results)

    return campaign.model_dump(mode="json") | results.model_dump(mode="json", exclude={"campaign"}), show


def _print_expected(expected: ExpectedRuns) -> None:
    problem = f" on the problem {expected.problem}" if expected.problem else ""
    typer.echo(f"the campaign can run{problem}; it proposes {expected.calibration_proposed:,} cells and simulates at most:")
    runs_of = {"sensitivity": expected.sensitivity_at_most, "calibration": expected.calibration_at_most}
    for stage, runs in (runs_of | {study: getattr(expected, study) for study in STUDIES}).items():
        typer.echo(f"  {stage:<12}{runs:>12,}")
    print_pace(expected)


def counted(campaign: Campaign) -> CellCounts:
    """Returns the cells of the search; without a search the cells of all stages together."""
    if campaign.cells.proposed:
        return campaign.cells
    fields = CellCounts.model_fields
    return CellCounts(**{name: sum(getattr(cells, name) for cells in campaign.stages.values()) for name in fields})


def _row(campaign: Campaign) -> list[object]:
    cells = counted(campaign)
    share = percent(saved(cells), 1) if cells.requested else None
    best = None if campaign.best is None else judged_text(campaign.best)
    return [
        *(campaign.id, campaign.state, campaign.kind, when(campaign.created_at)),
        *(cells.requested, cells.simulated, share, best),
        *(campaign.owner, " ".join(campaign.tags) or None, campaign.name),
    ]
