"""Views of a comparison: Table 5 over the seeds, and the effects of reductions."""

from collections.abc import Sequence
from typing import Any

import typer

from drivecal.cli.views.output import dumped, duration, print_columns
from drivecal.client.client import Client
from drivecal.contracts.comparison import ComparedGroup, ExpectedComparison, ReductionEffect
from drivecal.report.rows import compared_groups, reduction_effect


def comparison_document(client: Client, identifier: str) -> dict[str, Any]:
    """Returns all tables of a comparison, JSON-ready."""
    return {
        "runs": dumped(client.compared_runs(identifier)),
        "groups": dumped(client.compared_groups(identifier)),
        "pairs": dumped(client.compared_pairs(identifier)),
        "effects": dumped(client.reduction_effects(identifier)),
    }


def print_comparison(groups: Sequence[ComparedGroup], effects: Sequence[ReductionEffect]) -> None:
    """Prints Table 5 of the paper for these runs, and the effects of the reductions."""
    several = len({group.reduction for group in groups}) > 1
    header = ["optimizer", "population", *(["reduction"] if several else []), "best", "mean", "worst", "rating", "sets at best"]
    header += ["simulations", "converged", "iterations", "simulations until then", "as good as any"]
    print_columns(header, compared_groups(groups, with_reduction=several))
    typer.echo(
        "Over the seeds. Simulations are those that each run would take alone; it has converged when its best stays for 10 iterations."
    )
    if effects:
        typer.echo(
            "Objectives are of sets whose scores were all simulated: a search prefers sets that references make too good.\n"
        )
        _print_effects(effects)


def _print_effects(effects: Sequence[ReductionEffect]) -> None:
    header = ["optimizer", "population", "reduction", "pairs", "difference of the optimum", "95 % interval"]
    header += ["better", "equal", "worse", "sign test p", "differ at most", "simulations saved"]
    saved = [f"{effect.base_simulations - effect.simulations:,} ({effect.saved_share:.1%})" for effect in effects]
    print_columns(header, [[*reduction_effect(effect), text] for effect, text in zip(effects, saved, strict=True)])


def print_expected(expected: ExpectedComparison) -> None:
    """Prints the expected cost of a comparison."""
    typer.echo(f"the comparison can run: {expected.runs:,} runs propose {expected.proposed:,} cells")
    typer.echo(
        f"and simulate at most {expected.at_most:,}; what runs have in common, their start first of all, is simulated once"
    )
    if expected.seconds is not None:
        workers = "1 worker" if expected.workers == 1 else f"{expected.workers} workers"
        each = f"{expected.milliseconds:.1f} ms per simulation{'' if expected.measured else ', which is assumed: none was made yet'}"
        typer.echo(f"the simulations alone take at most about {duration(expected.seconds)} on {workers}, at {each}")
    else:
        typer.echo("the duration is unknown: there are no workers now")
    for note in expected.notes:
        typer.echo(f"note: {note}")
