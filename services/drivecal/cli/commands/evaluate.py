"""`drivecal evaluate`: drives one parameter set."""

from collections.abc import Iterator, Mapping
from itertools import zip_longest
from pathlib import Path
from typing import Annotated

import typer

from drivecal.cli.application import CampaignArgument, app, code_of_state, say
from drivecal.cli.views.output import Asked, asking, parameters_text, print_columns, print_evaluation, told
from drivecal.cli.views.progress import attached, pauses
from drivecal.client.client import Client
from drivecal.contracts.assignments import assignments, settings
from drivecal.contracts.evaluation import Difference, Evaluation, Explanation, SeriesAnswer
from drivecal.contracts.setup import ShapeAnswer
from drivecal.contracts.specification import DEFAULT_PROBLEM
from drivecal.contracts.tables import csv_text
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import InvalidInputError, NotFoundError, Problem, file_faults
from drivecal.domain.scales import score_text

SECONDS_BETWEEN_QUESTIONS = 0.3
SeedsOption = Annotated[
    int | None,
    typer.Option(min=1, max=1000, metavar="N", help="Runs of a random simulator in each scenario, under the seeds 1 to N."),
]
SUFFIXES = (".csv", ".parquet", ".json")
"""Endings of files of time series."""
VehicleOption = Annotated[str | None, typer.Option(metavar="NAME=VALUE,...", help="Other values of vehicle parameters.")]


@app.command()
@asking
def evaluate(
    client: Client,
    parameters: Annotated[list[str], typer.Argument(metavar="P1=VALUE...", help="One value for each parameter.")],
    scenario: Annotated[str | None, typer.Option(help="One scenario; else all.")] = None,
    problem: Annotated[str, typer.Option(help="highway, or the name or digest of a pushed problem.")] = DEFAULT_PROBLEM,
    catalogue: Annotated[str | None, typer.Option(help="The scenario catalogue.")] = None,
    vehicle: Annotated[str | None, typer.Option(help="The vehicle model: single_track, hybrid or a plug-in.")] = None,
    vehicle_parameters: VehicleOption = None,
    driving_function: Annotated[str | None, typer.Option(help="Who drives: frenet or a plug-in.")] = None,
    evaluator: Annotated[
        str | None, typer.Option(help="A score of the problem; on the motorway also reference, learned or a plug-in.")
    ] = None,
    seeds: SeedsOption = None,
    trace: Annotated[
        Path | None,
        typer.Option(help="Write the run's time series there: .csv or .parquet (one row per step), .json (all of it)."),
    ] = None,
    timeout: Annotated[float | None, typer.Option(min=0, help="Seconds to wait at most; then exit status 6.")] = None,
) -> Asked:
    """Simulate one parameter set and show its scores, with several seeds their means and 95 % intervals. Values may lie off the grid; a
    note names them."""
    differing = {} if vehicle_parameters is None else assignments(vehicle_parameters.split(","), "--vehicle-parameters")
    specification: dict[str, object] = {
        "parameters": settings(parameters, "parameters"),
        "problem": problem,
        "catalogue": catalogue,
        "driving_function": driving_function,
        "vehicle": {"model": vehicle, "parameters": differing},
        "evaluator": evaluator,
        "seeds": seeds or 1,
    }
    if scenario is not None:
        specification["scenario"] = scenario
    if trace is not None and (scenario is None or (seeds or 1) > 1 or trace.suffix not in SUFFIXES):
        raise typer.BadParameter(f"--trace needs one --scenario, one seed, and a file that ends in {', '.join(SUFFIXES)}")
    queued = client.evaluate(specification)
    say(f"evaluation {queued.id} is queued; `drivecal show {queued.id}` prints it as well")
    waiting = pauses(SECONDS_BETWEEN_QUESTIONS, timeout)
    evaluation = ended(client, queued, timeout, waiting)
    if trace is not None:
        save_series(trace_of(client, evaluation.id, timeout, waiting), trace)
        say(f"time series: {trace}")
    return (evaluation, lambda: print_evaluation(evaluation, client.problem(problem).shapes), code_of_state(evaluation.state))


def ended(client: Client, evaluation: Evaluation, timeout: float | None, waiting: Iterator[None]) -> Evaluation:
    """Returns an evaluation when it has ended. Raises WaitTimedOutError when `waiting`, the `pauses` of a command, end after `timeout`
    seconds."""
    goes_on = f"evaluation {evaluation.id} goes on; `drivecal show {evaluation.id}` prints it, `drivecal cancel {evaluation.id}` ends it"
    with attached(goes_on, timeout):
        while not CampaignState(evaluation.state).ended:
            next(waiting)
            evaluation = client.evaluation(evaluation.id)
    return evaluation


def trace_of(client: Client, evaluation: str, timeout: float | None, waiting: Iterator[None]) -> SeriesAnswer:
    """Returns the time series of an evaluation, for which the server simulates it again. Raises as `ended`."""
    with attached(f"the time series of evaluation {evaluation} are still being made; ask again", timeout):
        while (trace := client.trace(evaluation)) is None:
            next(waiting)
    return trace


@app.command()
@asking
def explain(
    client: Client,
    identifier: CampaignArgument,
    evaluation: Annotated[
        str, typer.Argument(metavar="EVALUATION", help="The number of a cell: the column `id` of the table `evaluations`.")
    ],
) -> Asked:
    """Explain why a cell was answered without a simulation, or why it was not."""
    campaign = client.campaign(identifier).id
    explanation = client.explanation(evaluation)
    if explanation.campaign != campaign:
        cell = f"evaluation of campaign {campaign} with the number"
        raise NotFoundError(cell, str(evaluation), f"campaign {explanation.campaign} has it")
    return explanation, lambda: print_explanation(explanation, client.setup(campaign).shapes)


def print_explanation(explanation: Explanation, shapes: Mapping[str, ShapeAnswer]) -> None:
    """Prints the explanation, the stored set that it names, and the parameters that differ. Iterations count from 1, as in `watch`."""
    where = f"{explanation.stage}, iteration {explanation.iteration + 1}, individual {explanation.individual}, {explanation.scenario}"
    result = explanation.outcome or "pending"
    if explanation.score is not None:
        result += f", score {score_text(explanation.score)}"
    result += f" ({explanation.failure})" if explanation.failure else ""
    if explanation.attempts > 1:
        result += f", {explanation.attempts} attempts"
    values = parameters_text(explanation.parameters, shapes=shapes)
    typer.echo(f"evaluation {explanation.evaluation}: {where}\n{values}\n{result}\n\n{explanation.sentence}")
    if explanation.detail is not None:
        typer.echo(told(explanation.outcome, explanation.detail))
    if (reference := explanation.reference) is not None:
        score = "no score yet" if reference.score is None else f"score {score_text(reference.score)}"
        at = f"{reference.stage}, iteration {reference.iteration + 1}, individual {reference.individual}"
        typer.echo(f"\nstored set: evaluation {reference.evaluation} of campaign {reference.campaign} ({at}), {score}")
    if (prediction := explanation.prediction) is not None:
        typer.echo(f"\nprediction: score {score_text(prediction.score)}, confidence {100 * prediction.confidence:.1f} %")
    if explanation.differences:
        typer.echo("")
        header = ["parameter", "this cell", "stored set", "influential", "this lies", "that lies", "in the way"]
        rows = [difference_row(difference) for difference in explanation.differences]
        shown = len(header) if any(row[3] != "everywhere" for row in rows) else 3  # without a map, all influence is unknown
        print_columns(header[:shown], [row[:shown] for row in rows])
    if explanation.distance is not None:
        typer.echo(f"\ndistance {explanation.distance:.4f} of the parameters' ranges")
    if explanation.stored is not None:
        typer.echo(f"searched {explanation.stored:,} stored results of the same setup")


def difference_row(difference: Difference) -> list[object]:
    """Returns a parameter that differs, as a row; a map says nothing of values outside its space."""
    regions = {difference.region, difference.reference_region}
    bounds: str | None
    if "anywhere" in regions:
        bounds = "nowhere"
    elif difference.lower is None and difference.upper is None:
        bounds = "everywhere" if "influential" in regions else None
    elif difference.lower is None:
        bounds = f"up to {difference.upper:g}"
    else:
        bounds = f"from {difference.lower:g}" if difference.upper is None else f"{difference.lower:g} .. {difference.upper:g}"
    return [
        difference.parameter,
        difference.value,
        difference.reference_value,
        bounds,
        difference.region,
        difference.reference_region,
        "yes" if difference.blocks else "no",
    ]


def save_series(trace: SeriesAnswer, file: Path) -> None:
    """Writes a table with a row per step (.csv, .parquet), or everything with plans and metrics (.json).

    Raises InvalidInputError if the file cannot be written.
    """
    columns = trace.series
    if not columns:
        raise InvalidInputError(Problem("--trace", "the run has no time series", "declare some under `series` in problem.yaml"))
    with file_faults(file, "written", "give another file"):
        if file.suffix == ".json":
            file.write_text(trace.model_dump_json(indent=1), encoding="utf-8")
        elif file.suffix == ".parquet":
            import pyarrow as pa  # not installed with the client alone
            import pyarrow.parquet as pq

            rows = list(zip_longest(*columns.values()))  # series may have different lengths, and none an entry
            pq.write_table(pa.table({name: [row[place] for row in rows] for place, name in enumerate(columns)}), file)
        else:
            with file.open("w", newline="", encoding="utf-8") as out:
                out.write(csv_text([columns, *zip_longest(*columns.values())]))
