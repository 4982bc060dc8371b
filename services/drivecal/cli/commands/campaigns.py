"""Commands about campaigns as a whole."""

from collections.abc import Callable, Iterable, Sequence
from typing import Annotated, TypeVar, get_args

import typer

from drivecal.cli.application import (
    COMMANDS,
    CampaignArgument,
    ExitCode,
    JsonOption,
    UrlOption,
    app,
    code_of_state,
    connect,
    say,
)
from drivecal.cli.views.output import (
    print_answer,
    print_campaign,
    print_evaluation,
    print_json,
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
def submit(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A campaign file, YAML or JSON; - is standard input.")],
    wait: WaitOption = False,
    timeout: TimeoutOption = None,
    dry_run: DryRunOption = False,
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Submit a campaign."""
    refuse_ignored(wait, timeout, dry_run=dry_run)
    with connect(url) as client, opened_document(file) as specification:
        if dry_run:
            print_answer(client.expected_runs(specification), as_json, _print_expected)
        else:
            submitted(client, client.submit(specification), wait, timeout, as_json)


@app.command()
def rerun(
    identifier: CampaignArgument,
    weights: Annotated[
        str | None, typer.Option(metavar="S1=2,S2=1", help="The new weights; a scenario that is not named has weight 1.")
    ] = None,
    evaluator: Annotated[
        str | None,
        typer.Option(help="Another score: one of the problem's, reference, learned or a plug-in; it rates stored runs."),
    ] = None,
    problem: Annotated[str | None, typer.Option(help="Another push of the problem, e.g. with another formula.")] = None,
    budget: Annotated[int | None, typer.Option(min=1, metavar="N", help="Simulations of the search.")] = None,
    name: Annotated[str | None, typer.Option(help="A name for the rerun.")] = None,
    wait: WaitOption = False,
    timeout: TimeoutOption = None,
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run an ended campaign again with other weights or another evaluator, on the stored results."""
    if weights is None and evaluator is None and problem is None and budget is None:
        raise typer.BadParameter("say what changes: --weights, --evaluator, --problem or --budget")
    refuse_ignored(wait, timeout)
    given = {"name": name, "evaluator": evaluator, "problem": problem}
    changes: dict[str, object] = {key: value for key, value in given.items() if value is not None}
    with connect(url) as client:
        first = client.campaign(identifier)
        spec = first.spec
        changes["weights"] = spec.get("weights", {}) if weights is None else assignments(weights.split(","), "--weights")
        if budget is not None:  # its other ends stay
            changes["budget"] = {**(spec.get("budget") or {}), "simulations": budget}
        submitted(client, client.rerun(first.id, changes), wait, timeout, as_json)


@app.command("list")
def list_campaigns(
    state: Annotated[CampaignState | None, typer.Option(help="Only campaigns in this state.")] = None,
    tags: Annotated[list[str] | None, typer.Option("--tag", help="Only campaigns with this tag; repeated: with all.")] = None,
    limit: Annotated[int, typer.Option(min=1, max=1000, help="How many at most, newest first.")] = 20,
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """List campaigns, newest first."""
    with connect(url) as client:
        page = client.campaigns(state=state, limit=limit, tags=tags or ())
    header = ["id", "state", "kind", "created", "requested", "simulated", "saved", "best", "owner", "tags", "name"]
    print_page(page, as_json, header, [_row(campaign) for campaign in page.items], limit)


@app.command()
def show(identifier: CampaignArgument, url: UrlOption = None, as_json: JsonOption = False) -> None:
    """Show one campaign, or a single evaluation by its whole id."""
    with connect(url) as client:
        _print_whole(client, client.campaign(identifier), as_json)


@app.command()
def watch(
    identifier: CampaignArgument, timeout: TimeoutOption = None, url: UrlOption = None, as_json: JsonOption = False
) -> None:
    """Follow a campaign until it has ended. Ctrl-C detaches and cancels nothing."""
    with connect(url) as client:
        campaign = follow(client, client.campaign(identifier).id, timeout, from_beginning=False)
        _print_whole(client, campaign, as_json)
    raise typer.Exit(code_of_state(campaign.state))


def _steering(action: Action) -> None:
    """Adds the command that asks for an action."""

    @app.command(action, help=COMMANDS[action][1])
    def steer(
        identifier: MaybeCampaign = None, tag: TagOption = None, url: UrlOption = None, as_json: JsonOption = False
    ) -> None:
        with connect(url) as client:
            chosen = _chosen(client, identifier, tag)
            if identifier is not None:
                _print_whole(client, client.act(chosen[0].id, action), as_json)
                return
            open_ones = [campaign.id for campaign in chosen if not CampaignState(campaign.state).ended]
            changed, refused = _each(open_ones, lambda campaign: client.act(campaign, action))
            ended = len(chosen) - len(open_ones)
            say(f"asked {len(changed)} of {len(chosen)} campaigns to {action}; {ended} have ended, {len(refused)} refuse")
            if as_json:
                print_json(list(changed.values()))
            _raise(refused)


for _action in get_args(Action):
    _steering(_action)


@app.command()
def label(
    identifier: CampaignArgument,
    name: Annotated[str | None, typer.Option(help="Another name.")] = None,
    tags: Annotated[list[str] | None, typer.Option("--tag", metavar="TAG", help="Add a tag; may be repeated.")] = None,
    untag: Annotated[list[str] | None, typer.Option(metavar="TAG", help="Take a tag away; may be repeated.")] = None,
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Change a campaign's name or tags."""
    if not (name or tags or untag):
        raise typer.BadParameter("say what changes: --name, --tag or --untag")
    with connect(url) as client:
        changed = client.label(identifier, name=name, add_tags=tags, remove_tags=untag)
    print_answer(changed, as_json, lambda it: typer.echo(f"campaign {it.id}  {it.name}\ntags     {' '.join(it.tags) or '-'}"))


@app.command()
def delete(identifier: MaybeCampaign = None, tag: TagOption = None, url: UrlOption = None, as_json: JsonOption = False) -> None:
    """Delete an ended campaign to which no other refers. What it simulated stays in the reference table."""
    with connect(url) as client:
        deleted, refused = _each([campaign.id for campaign in _chosen(client, identifier, tag)], client.delete)
    if as_json:
        print_json({"deleted": list(deleted)})
    for campaign in () if as_json else deleted:
        typer.echo(f"campaign {campaign} is deleted; what it simulated stays in the reference table")
    _raise(refused)


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


def _raise(refused: Sequence[DrivecalError]) -> None:
    """Says all refusals but the first, which it raises."""
    for other in refused[1:]:
        say(str(other))
    if refused:
        raise refused[0]


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


def submitted(client: Client, campaign: Campaign, wait: bool, timeout: float | None, as_json: bool) -> None:
    """Shows a new campaign, with `wait` at its end, and ends the command with the matching exit status."""
    code = ExitCode.OK
    if wait:
        say(f"campaign {campaign.id} is queued")
        campaign = follow(client, campaign.id, timeout)
        code = code_of_state(campaign.state)
    elif not as_json:
        say(f"queued; follow it with `drivecal watch {campaign.id}`")
    _print_whole(client, campaign, as_json)
    raise typer.Exit(code)


def _print_whole(client: Client, campaign: Campaign, as_json: bool) -> None:
    """Prints a campaign with its results; a single evaluation as `evaluate` does."""
    if campaign.kind == "evaluation":
        shapes = {} if as_json else client.problem(campaign.spec["problem"]).shapes
        print_answer(client.evaluation(campaign.id), as_json, lambda evaluation: print_evaluation(evaluation, shapes))
        return
    results = client.results(campaign.id)
    if as_json:
        known = results.model_dump(mode="json", exclude={"campaign"})
        print_json(campaign.model_dump(mode="json") | known)
        return
    print_campaign(campaign)
    print_results(results)


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
