"""The lines below a campaign in `show` and `watch`: trust in its result, the self-check by scenario, and the balance of reuse."""

from collections.abc import Mapping, Sequence

import typer

from drivecal.cli.views.output import duration, print_columns
from drivecal.contracts.accounting import DEDUCTIONS, Accounting, BreakEven
from drivecal.contracts.campaign import ErrorRate, Narrowed, Released
from drivecal.contracts.evaluation import FailureCause
from drivecal.contracts.results import TrustAnswer
from drivecal.domain.scales import COMFORT, Scale
from drivecal.report.rows import FAILURES, LOTS, LOTS_NOTE, error_rates, exceeds_limit, failure_causes, released_lots, totals


def print_trust(trust: TrustAnswer) -> None:
    """Prints the light of a campaign's result and its reasons, the gravest first; nothing without a reason."""
    if not trust.reasons:
        return
    typer.echo(f"\ntrust: {trust.light or 'open until the end'}")
    width = max(len(reason.light) for reason in trust.reasons) + 1
    for reason in trust.reasons:
        typer.echo(f"  {reason.light:<{width}}{reason.text}")


def print_error_rates(rates: Mapping[str, ErrorRate], scale: Scale = COMFORT) -> None:
    """Prints a line per scenario that was audited or has contradictions."""
    rows = error_rates(rates)
    if not rows:
        return
    tolerated = scale.amount(scale.tolerance)
    typer.echo(f"\nerrors of reused results, by simulating a sample of them (wrong: by more than {tolerated})")
    header = [
        "scenario",
        "audited",
        "different",
        "wrong",
        "R_err",
        "at most (95 %)",
        "contradictions",
        "lots",
        "rejected",
        "reuse",
    ]
    print_columns(header, rows)


def print_lots(released: Mapping[str, Released]) -> None:
    """Prints a line per scenario with inspected lots of predicted answers; nothing without lots."""
    rows = released_lots(released)
    if not rows:
        return
    typer.echo(
        "\npredicted answers, released in lots after the simulation of a sample (asked: batches in which the predictor was)"
    )
    print_columns(LOTS, rows)
    if exceeds_limit(released):
        typer.echo(LOTS_NOTE)


def print_failures(causes: Sequence[FailureCause]) -> None:
    """Prints a line per cause of failed cells; nothing without one."""
    if not causes:
        return
    typer.echo("\nfailed runs and cells without a result, by cause; `drivecal explain CAMPAIGN EXAMPLE` shows one")
    print_columns(FAILURES, failure_causes(causes))


def print_accounting(accounting: Accounting) -> None:
    """Prints the balance of a campaign in seconds of its workers."""
    clock = "CPU time" if accounting.clock == "cpu" else "wall-clock time"
    typer.echo(f"\nsavings, in {clock} of the workers")
    lines = [
        *((f"{outcome} cells", seconds) for outcome, seconds in accounting.savings.items()),
        *((DEDUCTIONS.get(name, name), -seconds) for name, seconds in accounting.deductions.items()),
    ]
    for name, seconds in lines:
        if seconds:
            typer.echo(f"  {name:26}{_signed(seconds):>16}")
    typer.echo(f"  {'net':26}{_signed(accounting.net_seconds):>16}")
    if accounting.audited:
        price = _seconds(accounting.audited_seconds)
        typer.echo(
            f"  the self-check simulated {accounting.audited:,} reusable cells in {price}; they are not counted as saved"
        )
    confirmed, proved = totals(accounting.scenarios, "confirmed", "proved")
    if confirmed:
        typer.echo(
            f"  {confirmed:,} copied or predicted scores were simulated after all, to confirm the best set; they are not counted as saved"
        )
    if proved:
        off = [
            f"{row.scenario} {row.proved_different:,} of {row.proved:,}"
            f"{f', {row.proved_wrong:,} of them wrong' * bool(row.proved_wrong)}"
            for row in accounting.scenarios
            if row.proved_different
        ]
        typer.echo(
            f"  certificates say of {proved:,} reused cells what a simulation would have given; another score: {'; '.join(off) or 'none'}"
        )
    if accounting.map is not None and not accounting.map.paid_here:
        paid = "is expert knowledge" if accounting.map.made_by is None else f"was paid by campaign {accounting.map.made_by}"
        cost = f" ({accounting.map.runs:,} runs, {_seconds(accounting.map.seconds)})" if accounting.map.runs else ""
        typer.echo(f"  the influence map {paid}{cost}")
    if accounting.break_even is not None:
        typer.echo(f"  {break_even_text(accounting.break_even)}")
    typer.echo(accounting.sentence)


def break_even_text(even: BreakEven) -> str:
    """Returns the number of requested cells from which the map pays."""
    if even.requested_cells is None:
        return "break-even: never at this rate, reuse saved nothing"
    text = f"break-even: the map pays from {even.requested_cells:,} requested cells on"
    if even.campaigns is not None:
        text += f", that is from {even.campaigns:,} such campaign{'' if even.campaigns == 1 else 's'} on"
    return text


def pays_text(share: float) -> str:
    """Returns the meaning of `ExpectedRuns.break_even_share` for a coming campaign."""
    if share > 1:
        return "the analysis cannot pay within this campaign: it takes more runs than there are cells to reuse; reruns share its map"
    return f"the analysis pays within this campaign if its map answers {share:.1%} of the requested cells"


def print_narrowed(narrowed: list[Narrowed] | None) -> None:
    """Prints the parts that were cut from the search space."""
    if not narrowed:
        return
    typer.echo("\nthe search was narrowed to where some scenario is influenced")
    header = ["parameter", "lower", "upper", "of lower", "of upper", "values left out", "of"]
    rows = [
        [
            *(cut.parameter, cut.choice or cut.lower, cut.choice or cut.upper),
            *(cut.full_lower, cut.full_upper, cut.removed_values, cut.values),
        ]
        for cut in narrowed
    ]
    print_columns(header, rows)


def _signed(seconds: float) -> str:
    return f"{'-' if seconds < 0 else '+'} {_seconds(abs(seconds))}"


def _seconds(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 60 else duration(seconds)
