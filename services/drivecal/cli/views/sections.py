"""Parts of the terminal's answers about a campaign's results and its front: tables and lines. Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from drivecal.contracts.campaign import Baseline, Best, ErrorRate, Released
from drivecal.contracts.evaluation import FailureCause
from drivecal.contracts.results import Accounting, FrontBaseline, FrontSummary, ResultTrust, VariantResult
from drivecal.contracts.tables import FrontRow, Solution, ValidationRow
from drivecal.domain.scales import Scale, objective_text, score_text, unit_text

OUTCOMES = ("simulated", "repeated", "reused", "predicted", "failed")
"""Outcomes of requested cells, frequent ones first."""
LOTS_NOTE = (
    "The limit holds for the expected number of errors over all lots together, by the rule that releases them; the 95 % bound is what the "
    "samples of this campaign alone prove, even if all are right: a few samples of a lot prove little about its other answers."
)
"""Explains a bound that exceeds the limit."""
_INSPECTED = "scenario", "asked", "lots", "rejected", "released", "sampled", "beyond tolerance"
LOTS = (*_INSPECTED, "mean error", "largest error", "limit", "at most (95 %)")
_CAUSES = {
    "no_result": "no result",
    "retried": "no result at first",
    "failed": "failed run",
    "unscored": "score without a value",
}
LONGEST_MESSAGE = 160


@dataclass(frozen=True, slots=True)
class Table:
    """A table with its caption; None is a dash."""

    header: Sequence[str]
    rows: Sequence[Sequence[object]]
    caption: str = ""


Block = Table | str
"""A table, or a line of text."""


def fixed(value: float | None, digits: int, separator: Literal["", ","] = "") -> str | None:
    """Returns a number with a fixed number of decimals and the `separator` of thousands; None for an unknown value."""
    return None if value is None else f"{value:{separator}.{digits}f}"


def objective_number(value: float | None) -> str | None:
    """Returns an objective as `objective_text` writes it; None for an unknown one."""
    return None if value is None else objective_text(value)


def percent(share: float | None, digits: int = 2) -> str | None:
    """Returns a share in percent; None for an unknown share."""
    return None if share is None else f"{100 * share:.{digits}f} %"


def bound(upper_95: float | None) -> str | None:
    """Returns a 95 % bound of a share in percent; `no bound` for 100 %, which excludes nothing, and None for an unknown one."""
    return "no bound" if upper_95 is not None and upper_95 >= 1.0 else percent(upper_95)


def shortened(words: str | None) -> str | None:
    """Returns the beginning of a message, which says what happened, and its end, where simulators say why."""
    half = LONGEST_MESSAGE // 2 - 2
    return words if words is None or len(words) <= LONGEST_MESSAGE else f"{words[:half]} .. {words[-half:]}"


def trust_blocks(trust: ResultTrust) -> list[Block]:
    """Returns the answers about a result, each with its verdicts, the gravest first."""
    blocks: list[Block] = []
    for answer in trust.answers:
        said = [f"  {each.light}: {each.text}" for each in trust.verdicts if each.question == answer.question]
        blocks += [f"{answer.title} {answer.text}.", *said]
    return blocks


def audits_table(rates: Mapping[str, ErrorRate], scale: Scale) -> list[Block]:
    """Returns the audits of copied scores by scenario; nothing without one."""
    rows = [
        [
            *(name, rate.audited, rate.different, rate.wrong),
            percent(rate.wrong / rate.audited if rate.audited else None),
            *(bound(rate.upper_95), rate.contradictions, rate.lots, rate.inspected, rate.rejected),
        ]
        for name, rate in rates.items()
        if rate.audited or rate.contradictions
    ]
    header = ["scenario", "audited", "different", "wrong", "R_err", "at most (95 %)"]
    header += ["contradictions", "lots", "in lots", "rejected"]
    caption = (
        f"Audits: copied scores that were simulated all the same; wrong: off by more than {scale.amount(scale.tolerance)}; a lot with too "
        "many wrong samples was rejected, and each cell of it simulated; at most: the share of wrong answers among those that lots released"
    )
    return [Table(header, rows, caption)] if rows else []


def lots_table(released: Mapping[str, Released]) -> list[Block]:
    """Returns the inspected lots of predicted answers by scenario; nothing without one."""
    rows = [
        [
            *(name, lots.asked, lots.lots, lots.rejected, lots.predicted, lots.sampled, lots.different),
            *(None if size is None else f"{size:.3g}" for size in (lots.mean_error, lots.largest_error)),
            *(percent(lots.limit, 1), bound(lots.upper_95)),
        ]
        for name, lots in released.items()
        if lots.lots
    ]
    caption = (
        "Predicted answers, released in lots after the simulation of a sample of each. Asked: batches in which the predictor was; beyond "
        "tolerance: samples; errors: how far off the samples of released lots were; limit: of the expected number of errors released, as a "
        "share of the expected number of predictions in lots"
    )
    exceeds = any(lots.upper_95 is not None and lots.upper_95 > lots.limit for lots in released.values())
    note: list[Block] = [LOTS_NOTE] if exceeds else []
    return [Table(LOTS, rows, caption), *note] if rows else []


def failures_table(causes: Sequence[FailureCause]) -> list[Block]:
    """Returns the causes of failed cells; nothing without one."""
    rows = [
        [
            *(cause.cells, _CAUSES[cause.kind], cause.cause, shortened(cause.detail), " ".join(cause.scenarios[:5])),
            str(cause.example),
        ]
        for cause in causes
    ]
    header = ["cells", "what", "cause", "last message", "scenarios", "example"]
    caption = "Failed runs and cells without a result by cause; `drivecal explain CAMPAIGN EXAMPLE` shows one"
    return [Table(header, rows, caption)] if rows else []


def account_blocks(account: Accounting | None) -> list[Block]:
    """Returns savings and costs; nothing before the first answered cell."""
    if account is None:
        return []
    clock = "CPU" if account.clock == "cpu" else "wall-clock"
    items = [*((item.label, item.seconds) for item in account.balance), ("net", account.net_seconds)]
    rows = [[label, f"{round(seconds, 1) + 0.0:+,.1f}"] for label, seconds in items]
    caption = f"Savings and costs, in {clock} time of the workers"
    blocks: list[Block] = [account.sentence, Table(["", f"{clock} s"], rows, caption)]
    return [*blocks, *(f"  {remark}" for remark in account.remarks)]


def broken_text(judged: Best | Baseline | FrontBaseline | Solution | FrontRow) -> str:
    """Returns by how much a set breaks constraints on results, or that it is not known."""
    return "not known to keep its rates" if judged.undecided else f"breaks constraints by {100 * judged.violation:.1f} %"


def judged_text(shown: Best | Baseline, missing: str = "no result yet") -> str:
    """Returns the objective of a set, or what it means that it is `missing`, and whether it breaks constraints."""
    objective = missing if shown.objective is None else objective_text(shown.objective)
    return f"{objective}, {broken_text(shown)}" if shown.violation > 0 else objective


def solutions_table(solutions: Sequence[Solution]) -> list[Block]:
    """Returns the best sets; nothing without a set."""
    if not solutions:
        return []
    first = solutions[0]
    broken = ["constraints"] if any(solution.violation > 0 for solution in solutions) else []
    random = any(solution.standard_error is not None for solution in solutions)
    uncertain = ["lower", "upper", "probability_best", "replicates", "runs_to_tell"] if random else []
    rows = [
        [
            *(solution.rank, objective_number(solution.objective), objective_number(solution.rating)),
            *(amount if isinstance(amount := getattr(solution, name), int) else score_text(amount) for name in uncertain),
            *(broken_text(solution) if solution.violation else "kept" for _ in broken),
            *(f"{value:.6g}" for value in solution.constraints.values()),
            *(score_text(score) + "*" * (name in solution.reused) for name, score in solution.scores.items()),
            *solution.parameters.values(),
        ]
        for solution in solutions
    ]
    caption = "The best sets; equal objectives are ordered by the continuous rating"
    if random:
        caption = (
            "The best sets, by what each reaches at least under the seeds that choose; further seeds, if any, give the figures"
        )
    if any(solution.reused for solution in solutions):
        caption += ". *: the score is that of a reference, this very set was not simulated there"
    header = ["rank", "objective", "rating", *uncertain, *broken, *first.constraints, *first.scores, *first.parameters]
    return [Table(header, rows, caption)]


def variants_table(variants: Sequence[VariantResult]) -> list[Block]:
    """Returns the best set of each variant and its value under the common set; nothing without variants."""
    if not variants:
        return []
    names = list(next((row.best.parameters for row in variants if row.best is not None), {}))
    rows = [
        [
            *(row.name, None if row.best is None else objective_number(row.best.objective), objective_number(row.common)),
            *(objective_number(row.cost), "breaks its constraints" if row.violation else ""),
            *(None if row.best is None else row.best.parameters[name] for name in names),
        ]
        for row in variants
    ]
    caption = "Variants: the best set of each, its value under the best common set, and what commonality costs"
    if any(row.best is not None and row.best.replicates > 1 for row in variants):
        caption += "; means over the seeds that both sets ran under: a small cost, or one below 0, may be luck"
    return [Table(["variant", "own best", "common", "cost", "", *names], rows, caption)]


def validation_tables(rows: Sequence[ValidationRow], scale: Scale) -> list[Block]:
    """Returns the shares of wrong answers by scenario: of released predictions, or of variants that a map calls equal."""
    if any(row.released is not None for row in rows):
        header = ["scenario", "released", "simulated", "different", "beyond tolerance"]
        header += ["per prediction in lots", "limit", "wrong"]
        caption = (
            "Released predictions, simulated afterwards; limit: of the expected errors released, for each prediction in a lot; each 95 % "
            "interval is that of a binomial share (Clopper-Pearson)"
        )
        cells = [
            [
                *(row.scenario, row.released, row.compared, row.different, row.beyond, percent(_per_inspected(row))),
                *(percent(row.limit, 1), row.wrong, *_rate(row)),
            ]
            for row in rows
        ]
    else:
        header = ["scenario", "reducible", "effects", "covered", "drawn", "bases", "variants", "compared", "different", "wrong"]
        caption = (
            "Share of wrong answers of the influence map with its 95 % interval. Reducible parameters have a region in which they do not "
            "matter; effects: of these and their interactions; bases: sets of the drawn Latin hypercube that qualify, each with variants. "
            "The interval is one of the mean over bases (by betting, for any distribution): variants of one basis are alike"
        )
        cells = [
            [
                *(row.scenario, row.reducible, row.effects, row.covered, row.drawn, row.bases, row.references),
                *(row.compared, row.different, row.wrong, *_rate(row)),
            ]
            for row in rows
        ]
    header += ["R_err", "95 % from", "to"]
    caption += f"; wrong: off by more than {scale.amount(scale.tolerance)}"
    return [Table(header, cells, caption)]


def _rate(row: ValidationRow) -> list[object]:
    return [percent(share) for share in (row.error_rate, row.lower_95, row.upper_95)]


def _per_inspected(row: ValidationRow) -> float | None:
    """Returns the errors released for each prediction in a lot, if the drawn predictions are like the others."""
    if not row.compared or not row.inspected:
        return None
    return (row.beyond or 0) / row.bases * (row.released or 0) / row.inspected


SHOWN = 20
"""Sets that a page shows, if no more are marked."""


def front_blocks(rows: Sequence[FrontRow], summary: FrontSummary, limit: int = SHOWN) -> list[Block]:
    """Returns what is known of a whole front, and `limit` of its sets, if no more are marked."""
    lines = [f"  {line}" for line in front_lines(summary)]
    if not rows:
        return [*lines]
    kept = shown_of_front(rows, limit)
    caption = "The front: no other set is better in one objective without being worse in another"
    if len(kept) < len(rows):
        caption += f"; {len(kept):,} of {len(rows):,} sets: the knee, the best of each objective, and the first others"
    if any(row.reused for row in kept):
        caption += ". *: a score is that of a reference"
    first = rows[0]
    weighted = ["weighted"] if first.weighted is not None else []
    seeds = ["seeds"] if any(row.replicates > 1 for row in kept) else []
    limited = [f"limited {name}" if name in first.objectives else name for name in first.constraints]
    header = ["rank", *first.objectives, *weighted, *limited, "wins", "sets", *seeds, "robust", "", *first.parameters]
    cells = [
        [
            row.rank,
            *(f"{amount:.6g}{_interval(row, name)}" for name, amount in row.objectives.items()),
            *(f"{row.weighted:.4f}" for _ in weighted),
            *(f"{amount:.6g}" for amount in row.constraints.values()),
            *(percent(row.wins, 1), row.alternatives, *(row.replicates for _ in seeds), row.degree),
            front_marks(row),
            *row.parameters.values(),
        ]
        for row in kept
    ]
    return [*lines, Table(header, cells, caption)]


def front_lines(summary: FrontSummary) -> list[str]:
    """Returns what is known of a whole front: a line for each objective and constraint, for the baseline, and the numbers of sets."""
    lines = []
    for objective in summary.objectives:
        unit = unit_text(objective.unit)
        ends = "" if objective.best is None else f", {objective.best:g} to {objective.worst:g}{unit} on the front"
        lines.append(f"{objective.direction} {objective.name} ({objective.aggregate}){ends}")
    lines += [f"subject to {constraint}" for constraint in summary.constraints]
    lines += [_baseline_line(summary, summary.baseline)] if summary.baseline is not None else []
    close = f", {summary.close:,} more cannot be told from these" if summary.close else ""
    lines.append(f"{summary.evaluated:,} sets evaluated, {summary.feasible:,} feasible, {summary.size:,} on the front{close}")
    return lines


def _interval(row: FrontRow, name: str) -> str:
    ends = [f"{row.uncertainty[f'{name}_{end}']:.4g}" for end in ("lower", "upper") if row.uncertainty]
    return f" ({' to '.join(ends)})" if ends else ""


def _baseline_line(summary: FrontSummary, baseline: FrontBaseline) -> str:
    units = {objective.name: unit_text(objective.unit) for objective in summary.objectives}
    amounts = ", ".join(f"{name} {amount:.6g}{units[name]}" for name, amount in baseline.objectives.items())
    broken = f"; {broken_text(baseline)}" if baseline.violation > 0 else ""
    beaten = "it breaks more of the constraints" if baseline.violation > 0 else "sets of the front beat it"
    place = beaten if baseline.rank is None else f"on the front, rank {baseline.rank}"
    return f"baseline: {amounts} ({place}){broken}"


def shown_of_front(rows: Sequence[FrontRow], limit: int) -> list[FrontRow]:
    """Returns the first sets of a front, `limit` in all; knee and best of each objective are kept even beyond the limit."""
    room = limit - sum(row.knee or bool(row.best_in) for row in rows)
    others = [row.rank for row in rows if not (row.knee or row.best_in)][: max(0, room)]
    return [row for row in rows if row.knee or row.best_in or row.rank in others]


def front_marks(row: FrontRow) -> str:
    """Returns what is special about a set of a front; a star: it has a score of a reference."""
    marks = [*(["knee"] if row.knee else []), *(f"best {name}" for name in row.best_in), *(["*"] if row.reused else [])]
    if row.violation > 0:
        marks.append(broken_text(row))
    if row.failures:
        marks.append(f"{row.failures} runs failed" if row.failures > 1 else "a run failed")
    return ", ".join(marks)
