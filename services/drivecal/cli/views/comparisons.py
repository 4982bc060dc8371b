"""Views of a comparison: Table 5 over the seeds, and the effects of reductions."""

from collections.abc import Sequence
from typing import Any

import typer

from drivecal.cli.views.output import duration, print_columns
from drivecal.client.client import Client
from drivecal.contracts.comparison import ComparedGroup, ExpectedComparison, ReductionEffect


def comparison_document(client: Client, identifier: str) -> dict[str, Any]:
    """All tables of a comparison, for programs."""
    return {
        "runs": [run.model_dump(mode="json") for run in client.compared_runs(identifier)],
        "groups": [group.model_dump(mode="json") for group in client.compared_groups(identifier)],
        "pairs": [pair.model_dump(mode="json") for pair in client.compared_pairs(identifier)],
        "effects": [effect.model_dump(mode="json") for effect in client.reduction_effects(identifier)],
    }


def print_comparison(groups: Sequence[ComparedGroup], effects: Sequence[ReductionEffect]) -> None:
    """Prints Table 5 of the paper for these runs, and below it what the reductions changed."""
    several = len({group.reduction for group in groups}) > 1
    header = ["optimizer", "population", *(["reduction"] if several else []), "best", "mean", "min", "rating", "sets at best"]
    header += ["simulations", "converged", "iterations", "simulations until then", "as good as any"]
    rows = [
        [
            *(group.optimizer, group.population, *([group.reduction] if several else [])),
            *(_number(value, 4) for value in (group.best, group.mean, group.minimum)),
            _number(group.rating, 3),
            _number(group.alternatives, 1),
            _number(group.simulations, 0),
            f"{group.converged} of {group.seeds}",
            _number(group.iterations_to_converge, 1),
            _number(group.simulations_to_converge, 0),
            f"{group.successes} of {group.seeds}",
        ]
        for group in groups
    ]
    print_columns(header, rows)
    typer.echo(
        "Over the seeds. Simulations are those that each run would take alone; it has converged when its best stays for 10 iterations."
    )
    if effects:
        typer.echo(
            "Objectives are those of sets of which each score was simulated for itself: a search prefers what references make too good.\n"
        )
        _print_effects(effects)


def _print_effects(effects: Sequence[ReductionEffect]) -> None:
    header = [
        "optimizer",
        "population",
        "reduction",
        "pairs",
        "difference of the optimum",
        "95 % interval",
        "better",
        "equal",
        "worse",
    ]
    rows = [
        [
            *(effect.optimizer or "all", effect.population or "all", f"{effect.reduction} - {effect.base}", effect.pairs),
            f"{effect.mean_difference:+.4f}",
            "-" if effect.lower_95 is None or effect.upper_95 is None else f"{effect.lower_95:+.4f} to {effect.upper_95:+.4f}",
            *(effect.better, effect.equal, effect.worse, f"{effect.sign_test:.3g}", f"{effect.different_upper_95:.1%}"),
            f"{effect.base_simulations - effect.simulations:,} ({effect.saved_share:.1%})",
        ]
        for effect in effects
    ]
    print_columns([*header, "sign test p", "differ at most", "simulations saved"], rows)


def print_expected(expected: ExpectedComparison) -> None:
    """Prints what a comparison would cost."""
    typer.echo(f"the comparison can run: {expected.runs:,} runs propose {expected.proposed:,} cells")
    typer.echo(
        f"and simulate at most {expected.at_most:,}; what runs have in common, their start first of all, is simulated once"
    )
    if expected.seconds is not None:
        workers = "1 worker" if expected.workers == 1 else f"{expected.workers} workers"
        each = f"{expected.milliseconds:.1f} ms per simulation{'' if expected.measured else ', which is assumed: none was made yet'}"
        typer.echo(f"that takes at most about {duration(expected.seconds)} on {workers}, at {each}")
    else:
        typer.echo("how long that takes is not known: there are no workers at this moment")
    for note in expected.notes:
        typer.echo(f"note: {note}")


def _number(value: float | None, digits: int) -> str | None:
    return None if value is None else f"{value:,.{digits}f}"
