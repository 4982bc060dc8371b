"""Verdicts on a campaign's results: the only place where a code with its numbers becomes a sentence. Pure."""

from collections.abc import Mapping, Sequence
from string import Formatter
from typing import Any, Literal

from drivecal.analysis.scoring import REMEDY
from drivecal.contracts.assignments import value_text
from drivecal.contracts.campaign import Confirmation
from drivecal.contracts.results import Light, Question, ResultAnswer, ResultVerdict
from drivecal.domain.rounding import same
from drivecal.domain.scales import objective_text, unit_text

SHORT = 8
"""Characters of a campaign's id in a sentence."""
CONFIRMED = {
    "confirmed": "Confirmed by simulation: the best objective is {objective:objective}, {belief}; {tried:n set} simulated again.",
    "untried": "Better sets may exist: the best simulated objective is {objective:objective}, others are believed to reach "
    "{reach:objective}; no more than {tried:n set} (reduction.confirm) were tried.",
    "unconfirmed": "Not confirmed: the best set's score in {copied:list} is still a copy; {tried:n set} (reduction.confirm) tried.",
    "unconfirmed_failed": "Not confirmed: the best set's score in {copied:list} is still a copy, for its simulation failed; "
    "{tried:n set} tried.",
    "dismissed": "{dismissed:n set} dismissed on a prediction alone.",
    "front_confirmed": "Confirmed by simulation: the {front:n set} of the front have scores of their own; {tried:n set} simulated again.",
    "front_untried": "Better sets may exist: others are believed to be on the front; no more than {tried:n set} (reduction.confirm) "
    "were tried.",
    "front_unconfirmed": "Not confirmed: {front_copied:,} of the {front:n set} of the front have copied scores; {tried:n set} "
    "(reduction.confirm) tried.",
}
SCORES = CONFIRMED | {
    "failed": "The campaign failed: {error}",
    "no_result": "No parameter set has a score in every scenario.",
    "not_judged": "The chosen set has no value of an objective or a constraint of the campaign: not every scenario has a result of its "
    "own.",
    "constraints_broken": "{subject} breaks the constraints by {share:.1 %}{bounded:after}.",
    "no_set_keeps_constraints": "No set keeps all constraints; the best set breaks them by {share:.1 %}{bounded:after}.",
    "constraints_undecided": "Runs do not decide whether {subject} keeps its rates; more seeds (replicates.most) or a larger budget "
    "may{bounded:after}.",
    "constraints_kept": "{subject} keeps the constraints{bounded:after}.",
    "constraints_left_out": "No constraint holds in {scenarios:list}, of weight 0: the search runs nothing there.",
    "fails": "Runs of {subject} fail in {scenarios:list}: see the causes of failures.",
    "scores_copied": "This very set was not simulated in {scenarios:list}: its scores there are copied.",
    "scores_simulated": "Every score of {subject} was simulated or repeats a simulation.",
    "never_confirmed": "The best set was not simulated again after the search (reduction.confirm is 0): a score may be a copy.",
    "front_copied": "{copied:,} of {size:,} sets of the front have a copied score.",
    "map_wrong": "The influence map is wrong for {rates:shares} of the variants, in the mean over bases (validation {study:id}). {then}",
    "map_validated": "The influence map was validated: {wrong:,} of {variants:,} variants were wrong, at most {worst:.1 %} in a scenario; "
    "in any, at most {upper:.1 %} are (95 %); more samples of a validation tell it more closely.",
    "map_unchecked": "The influence map answered cells without lots (max_error is 1), and was not validated.",
    "audits_wrong": "{wrong:,} of {audited:,} audited answers in {scenario} were wrong{then}.",
    "contradictions": "Groups of sets that the influence map calls equal, with different simulated scores: {groups:counts}.",
    "lots": "Of {inspected:,} cells that could be {kind}, in {lots:,} lots, {sampled:,} were simulated as samples; {rejected:,} lots had "
    "too many errors, and all their cells were simulated.",
    "predictions_validated": "{share:.1 %} of the simulated predictions in {scenario} are wrong (validation {study:id}); up to "
    "{allowed:.1 %} of the {released:,} released ones may be: {limit:.1 %} of the {inspected:,} in lots.",
    "noise": "{unrepeatable:,} simulations gave another result than an earlier run of the same cell: scores have noise.",
    "noise_unknown": "The simulator is random, and too few sets ran under several seeds: other seeds may give other scores and another "
    "order of sets. A larger budget, or more `replicates.most`, leaves runs to tell; an optimizer of your own asks for `replicates`.",
    "failing_runs": "Failed runs of {subject}: {failures:,}; up to {most:.1 %} of further runs may fail (95 %).",
    "without_result": "{count:,} of {requested:,} requested cells have no result ({share:.1 %}).",
    "without_score": "{count:,} of {requested:,} requested cells have no score, because the formula has no value ({share:.1 %}).",
    "cut": "{count:n cell} ({share:.1 %}) with a score that is worse than the worth of a failed run, and counts as it: "
    + REMEDY
    + ".",
    "at_worst": "Runs of {subject} did not fail, but have the worth of failed ones: {values:list}; " + REMEDY + ".",
    "robust": "The recommended set keeps its scores, within the study's limit, in the vehicles of the study that differ by up to "
    "{least}{radius:.1 %} of the ranges{failing}{unseen}.",
    "not_robust": "The recommended set breaks the study's limit in its first box of vehicles (it holds up to {least}{radius:.1 %} of the "
    "ranges).",
}
BASELINE = {
    "baseline_breaks_more": "The baseline breaks constraints that {subject} keeps, or breaks less.",
    "beside_baseline": "The chosen set beside the baseline: {objectives:compared}.",
    "better_than_baseline": "The best set is better than the baseline, by {gain:.4g}{under}.",
    "baseline_fails": "The baseline scores as a failed run in {scenarios:list}: a gain depends on what that is worth ({failed:g}).",
    "alike_baseline": "The best set is better than the baseline, by {gain:.4g}{under}, within the tolerance of {tolerance}.",
    "baseline_in_interval": "Runs do not tell the best set from the baseline{gained}; `drivecal check ID#1 --baseline campaign "
    "--seeds N` compares them under more seeds.",
    "failures_may_decide": "The best set is better than the baseline, by {gain:.4g}{under}; but up to {most:.1 %} of further runs may "
    "fail (95 %), and as a failed run is worth {failed:g}, that may cost more.",
    "not_better": "No set is better than the baseline.",
    "worse_than_baseline": "The best set is worse than the baseline, by {loss:.4g}{under}: it was chosen under others.",
    "baseline_without_result": "Nothing tells whether the best set is better than the baseline, which has no objective.",
    "front_beats_baseline": "{dominating:,} of {size:,} sets of the front are better than the baseline in an objective and worse in none.",
    "front_close_to_baseline": "{dominating:,} of {size:,} sets of the front look better than the baseline; runs do not tell them apart.",
    "front_not_better": "No set is better than the baseline in an objective and worse in none: each is worse in one, or equal.",
}
SEARCH = {
    "cancelled": "The campaign was cancelled before its search was complete.",
    "budget": "Of its budget the search used {used}.",
    "optima": "{sets:n set} share the best objective, in {regions:n region} of the space.",
    "seen": "The search asked for {asked} of the {grid} sets on the grid of its space, constraints aside.",
    "still_rising": "The best set was improved in the last of {iterations} iterations: more may improve it further.",
    "stood_still": "No iteration after the first found a better objective ({tried} tried). More iterations, wider ranges or another "
    "optimizer may find one.",
    "ended": "The search ended {by:end}; the best objective last changed after {share:.0 %} of its rounds.",
    "front_grew": "The search ended {by:end}; {late:,} of {size:n set} of the front were found in the second half of its rounds: more "
    "simulations would probably find others.",
    "front_stood": "The search ended {by:end}; no set of the front was found in the second half of its rounds.",
    "outlook": "Twice the budget would probably improve the best objective by at most {gain:.3g}, the most that one of the search's last "
    "three doublings brought; {record:.0 %} of such estimates held in the benchmark, of new searches of deterministic simulators.",
    "no_outlook_still": "What more simulations would bring is not known: no later set was better than the first ones.",
    "no_outlook": "What twice the budget would bring is not known: there is no record for less than {least} simulations, and this search "
    "has {simulations:,}.",
    "no_outlook_stored": "What twice the budget would bring is not known: there is a record for new searches alone, and {stored:,} of "
    "{requested:,} answers of this one were stored before.",
    "converged": "Converged by the paper's criterion for the {of}: found in iteration {iteration} of {iterations}, it then stayed as it "
    "was for at least {unchanged} iterations.",
    "not_converged": "Not converged by the paper's criterion for the {of}: it last changed in iteration {iteration} of {iterations}, and "
    "would have to stay for at least {unchanged} iterations.",
    "at_ends": "In {subject} {values:ends} at or near an end of the range; a wider range may hold better sets{entries:entries}.",
}
QUESTIONS: Mapping[Question, Mapping[str, str]] = {"scores": SCORES, "search": SEARCH, "baseline": BASELINE}
SENTENCES: Mapping[str, str] = SCORES | SEARCH | BASELINE
_ANSWERS: Mapping[Question, tuple[str, Mapping[Light, str]]] = {
    "scores": ("Does the result hold?", {"green": "Yes", "amber": "Check first", "red": "No"}),
    "search": ("Is the search finished?", {"green": "Yes", "amber": "Perhaps not", "red": "No"}),
    "baseline": ("Is it better than the baseline?", {"green": "Yes", "amber": "Not clearly", "red": "No"}),
}
_WEIGHT: Sequence[Light] = ("red", "amber", "green")


def verdict(code: str, light: Light | Literal["neutral"], scenario: str | None = None, **numbers: Any) -> ResultVerdict:
    """Returns a verdict with its sentence.

    Args:
        code: one of `SENTENCES`.
        light: what it means for the result.
        scenario: the only scenario that it is about.
        numbers: what it was found from, by the names in its sentence.
    """
    question = next(question for question, codes in QUESTIONS.items() if code in codes)
    text = sentence(code, numbers | {"scenario": scenario})
    return ResultVerdict(code=code, question=question, light=light, scenario=scenario, numbers=numbers, text=text)


def answers(verdicts: Sequence[ResultVerdict], *, ended: bool) -> list[ResultAnswer]:
    """Returns the answer to each question that a verdict is about: only red ones before the end."""
    given = []
    for question, (title, words) in _ANSWERS.items():
        lights = [each.light for each in verdicts if each.question == question]
        if lights:
            light: Light | None = next((each for each in _WEIGHT if each in lights and (ended or each == "red")), None)
            text = "Not known" if light is None and ended else "Open until the end" if light is None else words[light]
            given.append(ResultAnswer(question=question, title=title, light=light, text=text))
    return given


def sentence(code: str, numbers: Mapping[str, Any]) -> str:
    """Returns the sentence of a code with its numbers."""
    return _Words().vformat(SENTENCES[code], (), numbers)


def confirmation_verdict(confirmation: Confirmation) -> ResultVerdict:
    """Returns the verdict on the best set of a search, or its front, after its confirmation."""
    numbers = confirmation.model_dump()
    code: str = confirmation.state if confirmation.front is None else f"front_{confirmation.state}"
    if confirmation.failed:
        code += "_failed"
    if confirmation.objective is not None and confirmation.believed is not None:
        held = same(confirmation.objective, confirmation.believed)
        numbers["belief"] = "as the search believed" if held else f"the search believed {objective_text(confirmation.believed)}"
    lights: dict[str, Light] = {"confirmed": "green", "untried": "amber", "unconfirmed": "red"}
    confirmed = verdict(code, lights[confirmation.state], **numbers)
    if not confirmation.dismissed:
        return confirmed
    return confirmed.model_copy(update={"text": f"{confirmed.text} {sentence('dismissed', numbers)}"})


class _Words(Formatter):
    """Formats numbers, and lists and mappings of them, by formats that `str.format` does not have."""

    def format_field(self, value: Any, format_spec: str) -> str:
        """Returns a value in words; `n THING` counts things, and `.1 %` is a share in percent."""
        if format_spec.endswith(" %"):
            return f"{100 * value:{format_spec.removesuffix(' %')}f} %"
        if format_spec.startswith("n "):
            return f"{value:,} {format_spec[2:]}{'' if value == 1 else 's'}"
        known = _FORMATS.get(format_spec)
        return str(super().format_field(value, format_spec)) if known is None else known(value)


def _joined(parts: Sequence[str]) -> str:
    return f"{', '.join(parts[:-1])} and {parts[-1]}" if len(parts) > 1 else "".join(parts)


def _compared(objectives: Sequence[Mapping[str, Any]]) -> str:
    texts = []
    for each in objectives:
        unit, gain, tolerance = unit_text(each["unit"]), each["gain"], each["tolerance"]
        equal = same(each["value"], each["baseline"])
        change = "equal" if equal else f"{'better' if gain > 0 else 'worse'} by {abs(gain):.4g}{unit}"
        tolerated = f", within the tolerance of {tolerance:.4g}{unit}" if not equal and abs(gain) <= tolerance else ""
        texts.append(f"{each['name']} {each['value']:.6g}{unit}, baseline {each['baseline']:.6g}{unit}: {change}{tolerated}")
    return "; ".join(texts)


def _ends(values: Mapping[str, float]) -> str:
    return f"{', '.join(f'{name} ({value_text(value)})' for name, value in values.items())} {'lies' if len(values) == 1 else 'lie'}"


_FORMATS: Mapping[str, Any] = {
    "end": lambda by: "when its optimizer had finished" if by == "finished" else f"by its {by}",
    "objective": objective_text,
    "id": lambda value: value[:SHORT],
    "list": ", ".join,
    "after": lambda texts: f": {'; '.join(texts)}" if texts else "",
    "shares": lambda rates: _joined([f"{100 * rate:.1f} % in {scenario}" for scenario, rate in rates.items()]),
    "counts": lambda counts: _joined([f"{count:,} in {scenario}" for scenario, count in counts.items()]),
    "compared": _compared,
    "ends": _ends,
    "entries": lambda texts: f": change {_joined(texts)} in `problem.yaml`, push it, and submit again" if texts else "",
}
