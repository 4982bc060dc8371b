"""Results on stdout: plain columns that survive a pipe, or JSON."""

import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from functools import wraps
from inspect import Parameter, Signature, signature
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Concatenate

import typer
from pydantic import BaseModel
from pydantic_core import to_jsonable_python

from drivecal.cli.application import JsonOption, UrlOption, connect, say
from drivecal.cli.views.sections import (
    OUTCOMES,
    Block,
    Table,
    account_blocks,
    audits_table,
    failures_table,
    judged_text,
    lots_table,
    percent,
    shortened,
    solutions_table,
    trust_blocks,
    variants_table,
)
from drivecal.contracts.assignments import value_text
from drivecal.contracts.campaign import Best, Campaign, CellCounts, Pace
from drivecal.contracts.evaluation import Evaluation
from drivecal.contracts.results import CampaignResults, ImportanceAnswer
from drivecal.contracts.setup import ShapeAnswer
from drivecal.contracts.tables import Solution
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.events import ASKED
from drivecal.domain.scales import objective_text, score_text

if TYPE_CHECKING:
    from drivecal.client.client import Client

Shapes = Mapping[str, ShapeAnswer]
Show = Callable[[], None]
Asked = tuple[object, Show] | tuple[object, Show, int]
"""An answer, what prints it, and the exit status of its command if it may differ from 0."""


def asking(command: "Callable[Concatenate[Client, ...], Asked]") -> Callable[..., None]:
    """Returns a command with the options --url and --json: `command` gets a client of the server first, and returns what is shown."""

    @wraps(command)
    def shown(*, url: str | None, as_json: bool, **given: Any) -> None:
        with connect(url) as client:
            answer, show, *code = command(client, **given)
            print_answer(answer, as_json, show)
        raise typer.Exit(*code)

    _, *taken = signature(command, eval_str=True).parameters.values()
    for name, default, kind in (("url", None, UrlOption), ("as_json", False, JsonOption)):
        taken.append(Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=kind))
    shown.__annotations__ = {each.name: each.annotation for each in taken}
    shown.__signature__ = Signature(taken)  # type: ignore[attr-defined]  # Typer reads it
    return shown


def print_json(answer: object) -> None:
    """Prints an answer, of models or plain data, as JSON."""
    typer.echo(json.dumps(to_jsonable_python(answer), indent=2, ensure_ascii=False))


def print_answer(answer: object, as_json: bool, show: Show) -> None:
    """Prints an answer as JSON, or by `show`."""
    if as_json:
        print_json(answer)
    else:
        show()


def print_columns(header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Prints rows under a header, numbers to the right, text to the left."""
    cells = [
        ["-" if value is None else f"{value:g}" if isinstance(value, float) else str(value) for value in row] for row in rows
    ]
    numeric = [all(_is_number(row[column]) for row in cells) for column in range(len(header))]
    widths = [max(len(line[column]) for line in [list(header), *cells]) for column in range(len(header))]
    for line in [list(header), *cells]:
        parts = [
            text.rjust(width) if right else text.ljust(width) for text, width, right in zip(line, widths, numeric, strict=True)
        ]
        typer.echo("  ".join(parts).rstrip())


def print_page(page: BaseModel, header: Sequence[str], rows: Iterable[Sequence[object]], limit: int) -> None:
    """Prints a page of a list, and to stderr whether it continues."""
    print_columns(header, rows)
    if getattr(page, "next_cursor", None):
        say(f"there are more than {limit}; see them with --limit")


def print_campaign(campaign: Campaign) -> None:
    """Prints the summary of a campaign."""
    lines = [("campaign", f"{campaign.id}  {campaign.name}"), ("state", state_text(campaign))]
    if campaign.rerun_of:
        lines.append(("rerun of", campaign.rerun_of))
    if campaign.error:
        lines.append(("error", campaign.error))
    labels = {"owner": campaign.owner or "", "tags": " ".join(campaign.tags)}
    lines += [(title, text) for title, text in labels.items() if text]
    for label, stage in (("claims", "claims"), ("analysis", "sensitivity")):
        if (cells := campaign.stages.get(stage)) is not None and cells.requested:
            lines.append((label, f"{cells.requested:,} requested = {_sum(cells)}"))
    if campaign.cells.requested:
        lines.append(("cells", cells_text(campaign.cells)))
        if campaign.cells.runs < campaign.cells.simulated:
            lines.append(("runs", f"{campaign.cells.runs:,} started; other cells took runs that other campaigns made"))
    if campaign.budget is not None:
        lines.append(("search", _search_text(campaign)))
    hidden = {name for curve in campaign.curves.values() for name in curve["names"]}
    if campaign.baseline:
        ended = CampaignState(campaign.state).ended
        missing = "not rated: a run is missing, or lacks a measure of an objective or constraint" if ended else "no result yet"
        parameters = parameters_text(campaign.baseline.parameters, None, hidden)
        lines.append(("baseline", f"{judged_text(campaign.baseline, missing)}{_beside_text(campaign)}  {parameters}"))
    if campaign.best:
        best = campaign.best
        lines.append(("best", f"{judged_text(best)}  {parameters_text(best.parameters, None, hidden)}"))
        lines.append(("scores", "  ".join(f"{name} {score_text(score)}" for name, score in best.scores.items())))
        weights = campaign.spec.get("weights") or {}
        if not campaign.spec.get("variants") and {weights.get(name, 1.0) for name in best.scores} != {1.0}:
            lines.append(("weights", "  ".join(f"{name} {weights.get(name, 1.0):g}" for name in best.scores)))
        share = "1 parameter set has" if best.alternatives == 1 else f"{best.alternatives:,} parameter sets share"
        lines.append(("alternatives", f"{share} the best objective"))
        lines += [
            ("uncertainty", text)
            for text in _uncertainty_texts(best, (campaign.spec.get("replicates") or {}).get("aggregate", "mean"))
        ]
        if campaign.objective is not None and len(campaign.spec.get("objectives") or ()) > 1:
            by = campaign.objective.name
            lines.append(("front", f"drivecal front {campaign.id} lists the compromises; the best set is by {by} alone"))
    lines += [("note", note) for note in campaign.notes]
    seconds = campaign.seconds
    if seconds.wall:
        whole = f"{duration(seconds.wall)} since its start, pauses included"
        lines.append(("time", f"{whole}; CPU time of the simulations {duration(seconds.simulating)}"))
    width = max(len(name) for name, _ in lines)
    for name, text in lines:
        typer.echo(f"{name.ljust(width)}  {text}")


def _beside_text(campaign: Campaign) -> str:
    """Returns how many seeds make the baseline's objective, if runs are random, and the best set's objective under them."""
    baseline, best = campaign.baseline, campaign.best
    if baseline is None or baseline.objective is None or best is None or best.replicates < 2:
        return ""
    text = f" under {len(baseline.seeds)} seeds" if baseline.seeds else " under one seed"
    beside = baseline.best_objective
    return text if beside is None else f"{text} (the best set under them: {objective_text(beside)})"


def print_pace(expected: Pace) -> None:
    """Prints how long the most simulations take, as far as it is known, and the notes."""
    workers = "1 worker" if expected.workers == 1 else f"{expected.workers} workers"
    how = "measured" if expected.measured else "assumed: none was made yet"
    if expected.seconds is not None:
        each = f"{expected.milliseconds:.1f} ms of one per simulation, {how}"
        further = "planning, optimizers, predictions and starts of a simulator may take further time"
        typer.echo(f"about {duration(expected.seconds)} on {workers} ({each}); {further}")
    elif expected.workers is None:
        typer.echo("the duration is unknown: there are no workers now")
    for note in expected.notes:
        typer.echo(f"note: {note}")


def print_curves(shapes: Mapping[str, ShapeAnswer], sets: Mapping[str, Mapping[str, float | str]]) -> None:
    """Prints the curves and maps of `sets`, parameters by title, with the range of the campaign's good sets."""
    for name, shape in shapes.items() if sets else ():
        values = {title: shape.values(each) for title, each in sets.items()}
        if shape.good is not None:
            values |= {f"lowest of good sets ({shape.good.sets})": shape.good.lower, "highest": shape.good.upper}
        units = [f" {unit}" if unit != "1" else "" for unit in shape.axis_units]
        unit = "" if shape.unit == "1" else f" ({shape.unit})"
        typer.echo(f"\n{name}{unit}")
        is_map, columns = len(shape.axes) > 1, [f"{point:g}{units[-1]}" for point in shape.axes[-1]]
        rows = [
            [title, *([f"{point:g}{units[0]}"] if is_map else []), *row]
            for title, points in values.items()
            for point, row in (zip(shape.axes[0], points, strict=True) if is_map else [(0.0, points)])
            if isinstance(row, list)
        ]
        print_columns(["", "x", *(f"y {column}" for column in columns)] if is_map else ["", *columns], rows)


def _uncertainty_texts(best: Best, aggregate: str | Mapping[str, float]) -> Iterator[str]:
    """Yields what is known of the best set of a random simulator."""
    if best.lower is not None or best.upper is not None:
        what = aggregate if isinstance(aggregate, str) else f"quantile {aggregate['quantile']:g}"
        ends = " to ".join("unknown" if end is None else score_text(end) for end in (best.lower, best.upper))
        yield f"objective {ends} ({what} over the seeds that report it, of {best.replicates}); sets that may be as good: {best.close}"
    if best.failure_interval is not None:
        lower, upper = best.failure_interval
        yield f"{best.failures} of all its runs failed; by those that report it, {percent(lower, 1)} to {percent(upper, 1)} fail (95 %)"
    if best.noise:
        yield "spread of runs that did not fail, without what a seed does to all sets: " + "  ".join(
            f"{name} {score_text(noise)}" for name, noise in best.noise.items()
        )


def _search_text(campaign: Campaign) -> str:
    """Returns what the search has used of its budget, and its end."""
    limits = {name: f" of {limit:,.10g}" for name, limit in (campaign.budget or {}).items() if limit is not None}
    simulations, minutes = limits.get("simulations", ""), limits.get("minutes", "")
    spent = round(campaign.spent.minutes, 1 if campaign.spent.minutes >= 1.0 else 2)
    taken = f"{campaign.spent.stored:,} of them from the table, " if campaign.spent.stored else ""
    text = f"{campaign.spent.simulations:,}{simulations} simulations, {taken}{spent:,.10g}{minutes} min of searching"
    stored = campaign.cells.repeated + campaign.cells.reused
    if simulations and stored > 0 and (campaign.spec.get("optimizer") or {}).get("kind") == "surrogate":
        text += f"; {campaign.cells.requested:,}{simulations} cells asked for, {stored:,} stored answers among them"
    text += f"; {campaign.cells.discarded:,} cells of given-up sets left out" if campaign.cells.discarded else ""
    return text if campaign.ended_by is None else f"{text}; ended by: {campaign.ended_by}"


def print_solutions(solutions: Sequence[Solution], shapes: Mapping[str, ShapeAnswer]) -> None:
    """Prints a ranking."""
    blocks = solutions_table(solutions) or ["no parameter set has a result in every scenario yet"]
    print_ranked(blocks, {each.rank: each.parameters for each in solutions}, shapes)


def print_ranked(
    blocks: Iterable[Block], sets: Mapping[int, Mapping[str, float | str]], shapes: Mapping[str, ShapeAnswer]
) -> None:
    """Prints parts of a page without coefficients, and the curves and maps of the sets by rank."""
    print_blocks(blocks, coefficients_of(shapes))
    plain = {name: shape.model_copy(update={"good": None}) for name, shape in shapes.items()}
    print_curves(plain, {f"rank {rank}": each for rank, each in sets.items()})


def print_importance(answer: ImportanceAnswer) -> None:
    """Prints parameters by their importance, the largest first."""
    if answer.r2 is not None and answer.covered is not None:
        of = f"the score in {answer.scenario}" if answer.scenario else "the objective"
        sound = f"{answer.weak:g} or more is sound" if answer.covered >= answer.wide else "which holds near these sets only"
        over = f"{answer.sets:,} sets, the middle 80 % over {100 * answer.covered:.0f} % of the ranges"
        typer.echo(f"{of}, {over}; R² of the prediction {answer.r2:.2f}, {sound}\n")
        rows: list[list[str]] = []
        for item in sorted(answer.items, key=lambda item: -item.importance):
            is_little = item.upper < answer.clear and item.covered >= answer.wide  # wherever in its range
            said = "matters" if item.lower >= answer.clear else "explains little" if is_little else "not clear"
            figures = (f"{each:.3f}" for each in (item.importance, item.lower, item.upper, item.covered))
            rows.append([item.parameter, *figures, said if answer.r2 >= answer.weak else "not clear"])
        print_columns(["parameter", "importance", "95 % from", "to", "of range", ""], rows)
        typer.echo(f"\nshare of the variation (half the loss of R² if shuffled); it matters from {answer.clear:g}")
    for note in answer.notes:
        say(f"note: {note}")


def print_blocks(blocks: Iterable[Block], hidden: Collection[str] = ()) -> None:
    """Prints parts of a page, tables without the `hidden` columns."""
    for block in blocks:
        if isinstance(block, Table):
            if block.caption:
                typer.echo(f"\n{block.caption}")
            kept = [place for place, name in enumerate(block.header) if name not in hidden]
            print_columns([block.header[place] for place in kept], ([row[place] for place in kept] for row in block.rows))
        else:
            typer.echo(block)


def print_results(results: CampaignResults) -> None:
    """Prints the results of a campaign below its summary: curves, verdicts, checks, failures, and what it cost."""
    campaign, shapes = results.campaign, results.setup.shapes
    sets = {title: each.parameters for title, each in (("best", campaign.best), ("baseline", campaign.baseline)) if each}
    print_curves(shapes, sets | {f"best of {each.name}": each.best.parameters for each in results.variants if each.best})
    typer.echo("")
    print_blocks(
        [
            *variants_table(results.variants),
            *trust_blocks(results.trust),
            *audits_table(campaign.error_rate, campaign.scale),
            *lots_table(campaign.released),
            *failures_table(results.failures),
            *account_blocks(results.accounting),
        ],
        coefficients_of(shapes),
    )


def print_evaluation(evaluation: Evaluation, shapes: Mapping[str, ShapeAnswer]) -> None:
    """Prints the parameters, the result in each scenario, and the measures if there is one scenario."""
    if not CampaignState(evaluation.state).ended:
        typer.echo(f"evaluation {evaluation.id} is {evaluation.state}")
    typer.echo(parameters_text(evaluation.parameters, hidden=coefficients_of(shapes)))
    print_curves(shapes, {"": evaluation.parameters})
    for note in evaluation.notes:
        typer.echo(f"note: {note}")
    if evaluation.error:
        typer.echo(f"error: {evaluation.error}")
    names = ["scenario", "outcome", "score", "rating", "failure", "milliseconds"]
    if any(len(item.seeds) > 1 for item in evaluation.items):
        names[3:5] = ["standard_error", "lower", "upper", "failures"]
    header = ["CPU ms" if name == "milliseconds" else name.replace("_", " ") for name in names]
    print_columns(header, [[getattr(item, name) for name in names] for item in evaluation.items])
    for item in evaluation.items:
        if item.detail:
            words = told(item.outcome, shortened(item.detail))
            typer.echo(f"{item.scenario}: {words}; --json shows all of it")
    if evaluation.objective is not None and len(evaluation.items) > 1:
        typer.echo(f"mean score {objective_text(evaluation.objective)}{within_text(evaluation.lower, evaluation.upper)}")
    if evaluation.metrics:
        typer.echo("")
        shown = {name: None if value is None else f"{value:.4g}" for name, value in evaluation.metrics.items()}
        within = {name: within_text(*ends) for name, ends in evaluation.items[0].within.items()}
        print_columns(["metric", "value"], [[name, value and value + within.get(name, "")] for name, value in shown.items()])


def told(outcome: str | None, detail: str | None) -> str:
    """Returns the detail of a cell: why it has no result, or had none at the attempts before."""
    return f"{'' if outcome == 'failed' else 'no result at first: '}{detail}"


def within_text(lower: float | None, upper: float | None) -> str:
    """Returns the 95 % interval of a mean, to follow it; empty without one."""
    return "" if lower is None or upper is None else f" (95 %: {lower:.4g} to {upper:.4g})"


def state_text(campaign: Campaign) -> str:
    """Returns the state with stage, progress and requested action, on one line."""
    parts = [campaign.state]
    if campaign.stage and campaign.state == "running":
        parts.append(campaign.stage if campaign.iteration is None else f"{campaign.stage}, iteration {campaign.iteration + 1}")
    if campaign.progress.total and campaign.state != "succeeded":
        parts.append(f"{campaign.progress.done:,} of {campaign.progress.total:,} cells")
    if campaign.progress.eta_seconds is not None and campaign.state == "running":
        parts.append(f"about {duration(campaign.progress.eta_seconds)} left")
    if campaign.requested_action in ASKED:
        parts.append(ASKED[campaign.requested_action])
    return ", ".join([*parts, *troubles(campaign)])


def troubles(campaign: Campaign) -> list[str]:
    """Returns why a campaign does not go on, and what it waits for."""
    return [f"{name}: {text}" for name in ("degraded", "waiting") if (text := getattr(campaign, name))]


def cells_text(cells: CellCounts) -> str:
    """Returns the cells by outcome, on one line: `1,200 requested = 800 simulated + 300 reused + 100 repeated`."""
    kept = f"; {cells.carried_over:,} more carried over from the iteration before" if cells.carried_over else ""
    return f"{cells.requested:,} requested = {_sum(cells)}{kept}"


def _sum(cells: CellCounts) -> str:
    counts = by_outcome(cells).items()
    return " + ".join(f"{count:,} {name}" for name, count in counts if count or name == "simulated")


def by_outcome(cells: CellCounts) -> dict[str, int]:
    """Returns the requested cells by outcome, frequent ones first."""
    return {name: getattr(cells, name) for name in OUTCOMES}


def saved(cells: CellCounts) -> float:
    """Returns the share of the requested cells that needed no simulation."""
    answered = cells.repeated + cells.reused + cells.predicted
    return answered / cells.requested if cells.requested else 0.0


def coefficients_of(shapes: Mapping[str, ShapeAnswer]) -> set[str]:
    """Returns the parameters that curves and maps stand for."""
    return {name for shape in shapes.values() for name in shape.names}


def parameters_text(
    parameters: Mapping[str, Any], digits: int | None = 6, hidden: Collection[str] = (), shapes: Shapes = MappingProxyType({})
) -> str:
    """Returns values as `P1=0.5 mode=eco gain=[2, 1]`, without `hidden` ones; `digits` as of `value_text`. Curves and maps of `shapes`
    stand in the place of their coefficients."""
    values = {**parameters, **{name: shape.values(parameters) for name, shape in shapes.items()}}
    left_out = {*hidden, *coefficients_of(shapes)}
    return " ".join(f"{name}={value_text(value, digits)}" for name, value in values.items() if name not in left_out)


def duration(seconds: float) -> str:
    """Returns a duration as `8 s`, `3 min 05 s` or `2 h 10 min`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02} min"


def when(moment: datetime | None) -> str:
    """Returns a moment in the reader's time zone, with its offset: an hour comes twice when daylight saving time ends."""
    return "" if moment is None else moment.astimezone().isoformat(sep=" ", timespec="seconds")


def _is_number(text: str) -> bool:
    return text == "-" or text.removesuffix(" %").replace(",", "").replace(".", "", 1).removeprefix("-").isdigit()
