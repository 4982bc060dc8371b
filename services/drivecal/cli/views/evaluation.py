"""A single evaluation on the terminal."""

import typer

from drivecal.cli.views.output import parameters_text, print_columns
from drivecal.contracts.evaluation import Evaluation
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.scales import objective_text
from drivecal.report.rows import shortened


def print_evaluation(evaluation: Evaluation) -> None:
    """Prints the parameters, the result in each scenario, and the measures if there is one scenario."""
    if not CampaignState(evaluation.state).ended:
        typer.echo(f"evaluation {evaluation.id} is {evaluation.state}")
    typer.echo(parameters_text(evaluation.parameters))
    for note in evaluation.notes:
        typer.echo(f"note: {note}")
    if evaluation.error:
        typer.echo(f"error: {evaluation.error}")
    header = ["scenario", "outcome", "score", "rating", "failure", "worker ms"]
    print_columns(
        header,
        [[item.scenario, item.outcome, item.score, item.rating, item.failure, item.milliseconds] for item in evaluation.items],
    )
    for item in evaluation.items:
        if item.detail:
            typer.echo(f"{item.scenario}: {shortened(item.detail)}; --json shows all of it")
    if evaluation.objective is not None and len(evaluation.items) > 1:
        typer.echo(f"mean score {objective_text(evaluation.objective)}")
    if evaluation.metrics:
        typer.echo("")
        print_columns(
            ["metric", "value"],
            [[name, None if value is None else f"{value:.4g}"] for name, value in evaluation.metrics.items()],
        )
