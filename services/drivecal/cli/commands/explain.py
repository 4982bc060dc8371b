"""`drivecal explain`: why a cell was reused, or why it was not."""

from typing import Annotated

import typer

from drivecal.cli.application import CampaignArgument, JsonOption, UrlOption, app, connect
from drivecal.cli.views.output import parameters_text, print_answer, print_columns
from drivecal.contracts.explanation import Difference, Explanation, Prediction
from drivecal.domain.errors import NotFoundError
from drivecal.domain.scales import told


@app.command()
def explain(
    identifier: CampaignArgument,
    evaluation: Annotated[
        str, typer.Argument(metavar="EVALUATION", help="The number of a cell: the column `id` of the table `evaluations`.")
    ],
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Explain why a cell was answered without a simulation, or why it was not."""
    with connect(url) as client:
        campaign = client.campaign(client.full_id(identifier)).id
        explanation = client.explanation(evaluation)
    if explanation.campaign != campaign:
        cell = f"evaluation of campaign {campaign} with the number"
        raise NotFoundError(cell, str(evaluation), f"campaign {explanation.campaign} has it")
    print_answer(explanation, as_json, print_explanation)


def print_explanation(explanation: Explanation) -> None:
    """Prints the explanation, the stored set that it names, and the parameters that differ. Iterations count from 1, as in `watch`."""
    where = f"{explanation.stage}, iteration {explanation.iteration + 1}, individual {explanation.individual}, {explanation.scenario}"
    result = explanation.outcome or "pending"
    if explanation.score is not None:
        result += f", score {told(explanation.score)}"
    if explanation.failure:
        result += f" ({explanation.failure})"
    if explanation.attempts > 1:
        result += f", {explanation.attempts} attempts"
    known = [f"evaluation {explanation.evaluation}: {where}", parameters_text(explanation.parameters), result]
    typer.echo("\n".join([*known, "", explanation.sentence]))
    if explanation.detail is not None:
        typer.echo(explanation.detail)
    if explanation.reference is not None:
        reference = explanation.reference
        score = "no score yet" if reference.score is None else f"score {told(reference.score)}"
        at = f"{reference.stage}, iteration {reference.iteration + 1}, individual {reference.individual}"
        typer.echo(f"\nstored set: evaluation {reference.evaluation} of campaign {reference.campaign} ({at}), {score}")
    if explanation.prediction is not None:
        _print_prediction(explanation.prediction)
    if explanation.differences:
        typer.echo("")
        header = ["parameter", "this cell", "stored set", "influential", "this lies", "that lies", "in the way"]
        rows = [_line(difference) for difference in explanation.differences]
        if explanation.reason == "certified":  # a map would not have allowed it, and was not asked
            header, rows = header[:3], [row[:3] for row in rows]
        print_columns(header, rows)
    if explanation.distance is not None:
        typer.echo(f"\ndistance {explanation.distance:.4f} of the parameters' ranges")
    if explanation.stored is not None:
        typer.echo(f"searched {explanation.stored:,} stored results of the same setup")


def _print_prediction(prediction: Prediction) -> None:
    typer.echo(
        f"\nprediction: score {told(prediction.score)}, confidence {prediction.confidence:.1%}; stored answers with most weight:"
    )
    print_columns(
        ["evaluation", "stage", "iteration", "individual", "score", "weight"],
        [
            [known.evaluation, known.stage, known.iteration + 1, known.individual, known.score, f"{known.weight:.1%}"]
            for known in prediction.neighbours
        ],
    )


def _line(difference: Difference) -> list[object]:
    if "anywhere" in (difference.region, difference.reference_region):
        bounds = "nowhere"
    elif difference.lower is None and difference.upper is None:
        bounds = "everywhere"
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
