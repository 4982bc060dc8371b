"""The best sets of a campaign, and a summary of its results."""

from collections.abc import Iterable, Sequence

from drivecal.contracts.campaign import Baseline, Best, Campaign
from drivecal.contracts.tables import OptimumRow, RobustnessRow, Solution
from drivecal.domain.scales import objective_text, told, unit_text
from drivecal.report.data import ReportData
from drivecal.report.markup import bullets, paragraph, table
from drivecal.report.rows import Number, errors_text, fixed, objective_number, percent, range_text, totals
from drivecal.report.sections import reuse, search

SHOWN = 20
"""The best sets that the page shows; all of them are in the table."""
_NO_RESULT = "No parameter set has a result in every scenario."


def summary(findings: ReportData) -> list[str]:
    """Returns the summary."""
    campaign, best = findings.campaign, findings.campaign.best
    if best is None:
        nothing = "This campaign searched nothing." if campaign.spec.get("optimizer", {}) is None else _NO_RESULT
        return [bullets(_studies(findings)) if findings.robustness or findings.validation else paragraph(nothing)]
    regions = len({optimum.region for optimum in findings.optima})
    least = "at least " * (len(findings.optima) < best.alternatives)
    where = f", in {least}{regions} distinct regions" if regions > 1 else ""
    share = "1 parameter set has it" if best.alternatives == 1 else f"{best.alternatives:,} parameter sets share it{where}"
    first = f"The best objective is {objective_text(best.objective)} ({_meaning(campaign)}); {share}."
    if campaign.baseline is not None and campaign.baseline.objective is not None:
        first += f" The baseline has {objective_text(campaign.baseline.objective)}."
    if findings.solutions and findings.solutions[0].reused:
        where = ", ".join(findings.solutions[0].reused)
        first += f" The best set's score in {where} is a reference's; a search prefers those that are too good."
        first += " The command under Versions and repetition simulates it."
    sentences = [first, *search.convergence(findings.generations, findings.front_summary)[:1]]
    if findings.accounting is not None:
        sentences.append(findings.accounting.sentence)
    sentences += [_errors(campaign), _predictions(campaign), _proofs(findings), *_studies(findings)]
    return [bullets(sentence for sentence in sentences if sentence), _compared(findings, best)]


def _meaning(campaign: Campaign) -> str:
    """Returns which values of the objective are good: those of the first objective, or of the score."""
    goal = campaign.objective
    if goal is None:
        return range_text(campaign.scale)
    return f"{goal.name}{unit_text(goal.unit, ', ')}, {'higher' if goal.direction == 'maximise' else 'lower'} is better"


def trust(findings: ReportData) -> list[str]:
    """Returns the light of the result and the reasons for it; nothing without a reason."""
    if findings.trust is None or not findings.trust.reasons:
        return []
    light = paragraph(f"Light: {findings.trust.light or 'open until the end'}.")
    return [light, bullets(f"{reason.light}: {reason.text}" for reason in findings.trust.reasons)]


def _errors(campaign: Campaign) -> str:
    audited, different, wrong = totals(campaign.error_rate.values(), "audited", "different", "wrong")
    if not audited:
        return ""
    stopped = [name for name, error_rate in campaign.error_rate.items() if error_rate.stopped]
    text = errors_text("audited answers", audited, different, wrong, campaign.scale)
    lots, rejected = totals(campaign.error_rate.values(), "lots", "rejected")
    inspected = f" Of {lots:,} lots of reused answers {rejected:,} were rejected and simulated." if lots else ""
    return text + inspected + (f" Reuse was stopped in {', '.join(stopped)}." if stopped else "")


def _predictions(campaign: Campaign) -> str:
    names = ("lots", "rejected", "predicted", "sampled", "different")
    lots, rejected, predicted, sampled, beyond = totals(campaign.released.values(), *names)
    if not lots:
        return ""
    text = f"{predicted:,} answers are predictions of released lots"
    samples = f"of {sampled:,} samples of {lots:,} lots {beyond:,} are beyond the tolerance"
    return f"{text}; {samples}, {rejected:,} lots were rejected and simulated."


def _proofs(findings: ReportData) -> str:
    known, different, wrong = reuse.proved(findings.accounting)
    if not known:
        return ""
    return (
        f"Certificates say of {known:,} reused answers what a simulation would have given: {different:,} have another score, {wrong:,} are "
        "wrong."
    )


def _studies(findings: ReportData) -> list[str]:
    row, sentences = findings.recommended, []
    if row is not None:
        sentences.append(f"Recommended after the robustness study: rank {row.rank} of its table, because it has {row.reason}.")
    for validated in findings.validation[:1]:
        compared, different, wrong = totals(validated.rows, "compared", "different", "wrong")
        if compared:
            what = "variants in the validation of the influence map"
            sentences.append(errors_text(what, compared, different, wrong, findings.campaign.scale))
    return sentences


def _compared(findings: ReportData, best: Best) -> str:
    baseline, recommended = findings.campaign.baseline, findings.recommended
    rows = [_row("best", best, best)]
    caption = f"The best set: its score ({range_text(findings.campaign.scale)}) in each scenario and its parameter values"
    if recommended is not None:
        rows.append(_row("recommended", recommended, best))
        caption += "; beside it the set that the robustness study recommends"
    if baseline is not None:
        rows.append(_row("baseline", baseline, best))
    return table(["", "objective", *best.scores, *best.parameters], rows, caption)


def _row(name: str, compared: Best | Baseline | RobustnessRow, best: Best) -> list[object]:
    scores = [compared.scores.get(scenario) for scenario in best.scores]
    values = [compared.parameters.get(parameter) for parameter in best.parameters]
    return [name, objective_number(compared.objective), *scores, *values]


def solutions_table(solutions: Sequence[Solution], optima: Iterable[OptimumRow]) -> str:
    """Returns the table of the best sets, with the regions of those that share the best objective."""
    if not solutions:
        return ""
    known = {optimum.rank: optimum for optimum in optima}
    first, shown = solutions[0], solutions[:SHOWN]
    broken = ["breaks constraints by"] if any(solution.violation > 0 for solution in shown) else []
    rows = [
        [
            *(solution.rank, objective_number(solution.objective), fixed(solution.rating, 3)),
            known[solution.rank].region if solution.rank in known else None,
            *(percent(solution.violation or None, 1) for _ in broken),
            *(Number(f"{amount:.6g}") for amount in solution.constraints.values()),
            *(Number(f"{told(score)}*" if name in solution.reused else told(score)) for name, score in solution.scores.items()),
            *solution.parameters.values(),
        ]
        for solution in shown
    ]
    caption = (
        "The best set"
        if len(shown) == 1
        else f"The {len(shown)} best sets; equal objectives are ordered by the continuous rating"
    )
    if any(solution.reused for solution in shown):
        caption += ". A star: the score is that of a reference, this very set was not simulated there"
    header = ["rank", "objective", "rating", "region", *broken, *first.constraints, *first.scores, *first.parameters]
    return table(header, rows, caption)
