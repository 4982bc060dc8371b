"""Row models of all tables; columns, files, JSON and OpenAPI schemas follow from them."""

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, Field
from pydantic_core import to_json

from drivecal.contracts.campaign import Answer, GenerationCounts, Page, Score
from drivecal.domain.scales import MOST_BARS

Kind = Literal["integer", "number", "score", "text", "truth", "numbers"]
"""A `score` is an integer or a number, depending on the campaign's scale."""
_KINDS: dict[object, Kind] = {bool: "truth", int: "integer", float: "number", str: "text"}
_FORMULA = re.compile(r'[ "]*[=+\-@＝＋－＠]|\A[\t\r]')  # the wide signs begin formulas as well
_PARTS = re.compile(r"([;\t\r\n]+)")
_QUOTED = re.compile(r'[",;\t\r\n]')


def spreadsheet_text(value: str) -> str:
    """Returns a text of a CSV file that no spreadsheet takes for a formula: with an apostrophe before it, unless it is a number.

    The same holds for its parts: a spreadsheet whose separator is `;` or a tab splits a text there, in spite of quotes.
    """
    if _FORMULA.search(value) is None or _is_number(value):
        return value
    parts = [f"'{part}" if _FORMULA.match(part) and not _is_number(part) else part for part in _PARTS.split(value)]
    return "".join(parts)


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Returns lines of CSV (RFC 4180): missing values are empty, truth is `true` and `false`, lists are JSON, numbers keep all digits.

    Texts that a spreadsheet would carry out as a formula begin with an apostrophe.
    """
    columns = map(_fields, zip(*rows, strict=True))
    return "".join(f"{','.join(fields) or _EMPTY}\r\n" for fields in zip(*columns, strict=True))


_EMPTY = '""'
_AS_THEY_ARE = frozenset({int, float, NoneType})


def _fields(column: Sequence[object]) -> list[str]:
    kinds = set(map(type, column))
    if kinds <= _AS_THEY_ARE:
        return to_json(column).decode()[1:-1].replace("null", "").split(",")  # a sixth of the time of `str`
    if not all(issubclass(kind, str | bool | NoneType) for kind in kinds):
        return list(map(_field, column))
    known = {value: _field(value) for value in set(column)}  # words repeat
    return [known[value] for value in column]


def _field(value: object) -> str:
    if type(value) in _AS_THEY_ARE:
        return "" if value is None else str(value)
    return _text_field(json.dumps(value) if isinstance(value, bool | list) else str(value))


@lru_cache(maxsize=1024)
def _text_field(value: str) -> str:
    text = spreadsheet_text(value)
    return '"' + text.replace('"', '""') + '"' if _QUOTED.search(text) else text


def _is_number(value: str) -> bool:
    try:
        float(value)
    except ValueError:
        return False
    return True


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a file and what it holds; every value may be missing."""

    name: str
    kind: Kind


@dataclass(frozen=True, slots=True)
class Spread:
    """Mark of a mapping whose keys are columns of a file; without a prefix they are parameters."""

    prefix: str = ""

    def column(self, key: str) -> str:
        """Returns the column of a key."""
        return self.prefix + key if self.prefix else parameter_column(key)


@dataclass(frozen=True, slots=True)
class FileForm:
    """Mark of a field that looks different in a file."""

    kind: Kind
    convert: Callable[[Any], object]


LEAST_BINS = 7
"""Bins on both sides of 0 that every file has, enough for the comfort score."""
JSON_ONLY = "JSON only"
"""Mark of a field that no file has."""
_JOINED = FileForm("text", lambda words: " ".join(map(str, words)))
Keys = Mapping[str, Sequence[str] | Mapping[str, "Kind"]]
"""Keys of a row's mappings by field, with their kinds if they differ."""


def columns_of(model: type[BaseModel], keys: Keys | None = None, *, whole_scores: bool = True) -> list[Column]:
    """Returns the columns of a file of such rows. `keys`: the keys of its mappings, by field."""
    columns: list[Column] = []
    for name, field in model.model_fields.items():
        mark = _mark(field.metadata, field.annotation)
        if isinstance(mark, Spread):
            listed = (keys or {})[name]
            kinds = listed if isinstance(listed, Mapping) else dict.fromkeys(listed, _kind(get_args(field.annotation)[1]))
            columns += [Column(mark.column(key), kind) for key, kind in kinds.items()]
        elif isinstance(mark, FileForm):
            columns.append(Column(name, mark.kind))
        elif mark is None:
            columns.append(Column(name, _kind(field.annotation)))
    score: Kind = "integer" if whole_scores else "number"
    return [replace(column, kind=score) if column.kind == "score" else column for column in columns]


def file_row(row: BaseModel) -> dict[str, Any]:
    """Returns the values of a row in a file, by column."""
    flat: dict[str, Any] = {}
    for name, field in type(row).model_fields.items():
        mark, value = _mark(field.metadata, field.annotation), getattr(row, name)
        if isinstance(mark, Spread):
            flat |= {mark.column(key): each for key, each in value.items()}
        elif isinstance(mark, FileForm):
            flat[name] = mark.convert(value)
        elif mark is None:
            flat[name] = value
    return flat


def parameter_column(name: str) -> str:
    """Returns the column of a parameter, the same in all tables and distinct from their other columns."""
    return f"parameter_{name}" if name in _OTHER_COLUMNS or name.startswith(_PREFIXES) else name


def measure_column(name: str) -> str:
    """Returns the column of a measure, distinct from all other columns of evaluations: parameters may have the same name."""
    return f"measure_{name}"


def _mark(metadata: Sequence[Any], annotation: Any) -> Spread | FileForm | str | None:
    marks = [mark for mark in metadata if isinstance(mark, Spread | FileForm) or mark == JSON_ONLY]
    return marks[0] if marks else _JOINED if annotation in (list[str], list[int]) else None


def _kind(annotation: Any) -> Kind:
    options = get_args(annotation) if get_origin(annotation) in {UnionType, Union} else (annotation,)
    if {int, float} <= set(options):
        return "score"
    [plain] = [option for option in options if option is not NoneType]
    if get_origin(plain) is Literal:
        return "text"
    return "numbers" if get_origin(plain) is list else _KINDS[plain]


def _counts_by_bin(histogram: Mapping[int, int]) -> list[float]:
    last = min(MOST_BARS + 1, max([LEAST_BINS, *map(abs, histogram)]))
    counts = [0.0] * (2 * last + 1)
    for number, count in histogram.items():
        counts[max(-last, min(last, number)) + last] += count
    return counts


TableName = Literal["evaluations", "generations", "solutions", "front", "influence", "robustness", "validation"]

PLACE = 5
"""Leading fields of an evaluation's row, which say which cell it is; its parameters follow."""


class EvaluationRow(Answer, extra="allow"):
    """A requested cell; each parameter is a field with its name.

    `outcome` is null while the answer is pending. `purpose` says what the cell was asked for: `search`; `start`, the baseline and start
    sets; `choice`, seeds that decide between sets; `report`, seeds that report the best one; `confirmation` of a copied or predicted score;
    `audit` of the reference, or `sample` of the predictions that could have answered it (`agrees` says whether its prediction was right);
    `evaluation`; or the name of another stage. `reference`: the evaluation that answered it, or that its audit did not trust. `lot`: the
    lot of a predicted or reused cell, also if its sample or the whole lot was simulated; `confidence`: the predictor's share of votes,
    0 to 1, for every cell that it was asked about.
    """

    __pydantic_extra__: dict[str, float | str | None]

    id: int
    stage: str
    iteration: int
    """Counted from 0; commands and page count iterations from 1."""
    individual: int
    scenario: str
    outcome: str | None
    purpose: str
    score: Score | None
    rating: float | None
    reference: int | None
    agrees: bool | None
    failure: str | None
    milliseconds: float | None
    """CPU time of the cell's simulations, a second run included; null without one."""
    worker: str | None
    runs: int = 0
    """Starts of the simulator for it: 0 if another run answered it, more than 1 with repeats, breakdowns and lost workers."""
    lot: int | None = None
    confidence: float | None = None
    seed: int | None = None
    """Seed of the run; null if the simulator does not depend on one."""

    @classmethod
    def file_columns(cls, parameters: Mapping[str, Kind], *, whole_scores: bool = True) -> list[Column]:
        """Returns the columns of a file, with the parameters behind the place of the cell."""
        own = columns_of(cls, whole_scores=whole_scores)
        return own[:PLACE] + [Column(parameter_column(name), kind) for name, kind in parameters.items()] + own[PLACE:]


class _Iteration(Answer):
    iteration: int
    """Counted from 0; commands and page count iterations from 1."""


class Generation(GenerationCounts, _Iteration):
    """An iteration of the calibration stage. `mean` and `minimum` (the worst) are over all its sets, also sets that break constraints."""

    best: float | None = None
    """The best objective so far."""
    rating: float | None = None
    """The weighted continuous rating of the best set so far."""
    mean: float | None = None
    minimum: float | None = None
    alternatives: int = 0
    """Distinct parameter sets seen so far whose objective equals the best so far."""


class Solution(Answer):
    """An evaluated parameter set. `rank` counts from 1: sets that keep the constraints come first, then objective, `rating` and discovery
    decide. `violation` is the sum of the violations, as shares. `constraints` has the bounded values by constraint name; a rate NAME has
    `NAME_lower` and `NAME_upper` as well, the exact bounds of the share that was found."""

    rank: int
    objective: float
    rating: float
    violation: float = 0.0
    undecided: bool = False
    """Its runs do not decide whether it keeps its rates, and it keeps all other constraints; `violation` is small then, and above 0."""
    constraints: Annotated[dict[str, float], Spread("constraint_")] = Field(default_factory=dict)
    scores: Annotated[dict[str, Score], Spread("score_")]
    reused: list[str] = Field(default_factory=list)
    """Scenarios whose score is that of a reference: this very set was not simulated there."""
    parameters: Annotated[dict[str, float | str], Spread()]
    iteration: int
    """Counted from 0; commands and page count iterations from 1."""
    individual: int
    replicates: int = 1
    """Seeds under which it ran in every scenario."""
    failures: int = 0
    """Failed runs under all its seeds."""
    seeds: list[int] = Field(default_factory=list)
    """Seeds whose runs make objective and scores, if it ran under several: the last ones, which choose no set, if it has two of them."""
    standard_error: float | None = None
    """Standard error of the objective; this and the following are null if the simulator is not random, and while the noise is unknown."""
    lower: float | None = None
    """Lower end of the interval of the objective, at `replicates.confidence`."""
    upper: float | None = None
    """Upper end of that interval."""
    probability_best: float | None = None
    """Probability that no other set is better; a failure counts by the share of runs that fail. Null for a quantile if runs failed."""
    runs_to_tell: int | None = None
    """Number of runs of this set and of the best set that would show which is better; null if that is known."""


class FrontRow(Answer):
    """A set that no other evaluated set dominates; `rank` counts from 1, best first objective first, or largest `weighted` first.

    `alternatives` counts the sets with the same objectives, with this one. The `knee` gives the most for what it costs. No set is better in
    the objectives `best_in`. `wins` is its share of all weightings of the objectives, scaled to the front, and `weights` has the corners of
    that region; both are null for more than three objectives, and for more than 1,000 sets of three. `violation` is the sum of the
    violations, as shares; above 0 only if no set keeps all constraints. `undecided` and `constraints` are as of `Solution`. `degree` comes
    from the robustness stage, if any.
    """

    rank: int
    objectives: Annotated[dict[str, float], Spread("objective_")]
    uncertainty: Annotated[dict[str, float], Spread("objective_")] = Field(default_factory=dict)
    """Standard error `NAME_error` and interval `NAME_lower` to `NAME_upper`, at `replicates.confidence`, of each objective's mean over all
    seeds of a random simulator: around the value less the luck that it takes to get on the front, as far as all sets tell."""
    weighted: float | None = None
    """The weighted sum of the scaled objectives, 0 to 1, if weights were given."""
    violation: float
    undecided: bool = False
    constraints: Annotated[dict[str, float], Spread("constraint_")] = Field(default_factory=dict)
    knee: bool
    best_in: list[str]
    wins: float | None
    weights: Annotated[list[list[float]] | None, JSON_ONLY]
    alternatives: int
    replicates: int = 1
    """Number of its seeds."""
    failures: int = 0
    """Failed runs under all seeds of the set; the report's count as well."""
    seeds: list[int] = Field(default_factory=list)
    """Seeds whose runs make its values, if it ran under several: of the first ones, which choose, even if further ones report it."""
    degree: int | None
    scores: Annotated[dict[str, Score], Spread("score_")]
    values: Annotated[dict[str, float], Spread("value_")] = Field(default_factory=dict)
    """Scores and measures of objectives and constraints in each scenario, by `NAME@SCENARIO`."""
    reused: list[str]
    """Scenarios whose score is that of a reference: this very set was not simulated there."""
    answers: Annotated[dict[str, str], Spread("answer_")] = Field(default_factory=dict)
    """Kind of the answer in each scenario: simulated or repeated; reused: its score is that of a reference; confirmed: a
    copied or predicted score that a simulation of this very set replaced; stored: by a run of another campaign."""
    parameters: Annotated[dict[str, float | str], Spread()]
    iteration: int
    """Counted from 0."""
    individual: int


class JudgedSet(Answer):
    """An evaluated set by its objectives, on the front or not; `violation` of the constraints in shares, 0 if all are kept."""

    objectives: Annotated[dict[str, float], Spread("objective_")]
    violation: float
    on_front: bool
    """True if no other set dominates it."""
    iteration: int
    """Counted from 0."""
    individual: int


DecidedBy = Literal["intervals", "confirmation", "global", "unknown", "posted", "space"]
"""The analysis that decided about a parameter: its intervals; the analysis of its whole range after them; the global analysis; no known
result; a user who posted the map; the campaign's space, which holds none of the influential range."""


class InfluenceRow(Answer):
    """A parameter in a scenario. `lower` and `upper` are the inclusive influential bounds in parameter units, the space's own
    if nothing is cut, null if nothing is influential, and of a choice. Results of an analysis are null in maps that a user posted."""

    scenario: str
    parameter: str
    influential: bool
    lower: float | None
    upper: float | None
    s_rel_intervals: list[float | None] | None = None
    """A value per interval, from the lower end of the space to the upper; null with too few results, and if the analysis is sequential
    also between the first influential intervals from both ends, which need no runs."""
    mu: float | None = None
    sigma: float | None = None
    mu_star: float | None = None
    unknown: bool = False
    """True if nothing is known about it, which counts as influential: the map does not list it, or no run of the scenario was better than a
    failed one."""
    unit: str | None = None
    space_lower: float | None = None
    space_upper: float | None = None
    n_values: int | None = None
    """Number of the parameter's values from `space_lower` to `space_upper`."""
    decided_by: DecidedBy | None = None
    """The analysis that decided whether it is influential; null for posted maps."""


class BoxTrial(Answer):
    """A solution in the vehicles of one box: `radius` is half its width in shares of the vehicle parameters' ranges; `deviations` are what
    the condition compares with eta, by scenario, null if a vehicle has no result."""

    box: int
    radius: float
    holds: bool
    deviations: dict[str, float | None]


class RobustnessRow(Answer):
    """A best set; rows are ordered by degree of robustness, objective, rating.

    `scores` were simulated in the nominal vehicle. The condition holds up to `degree` multiples of delta, or more with `at_least`. `radius`
    is the half width of the widest box that holds (delta_max from below). Sets with the same `region` are neighbours, or
    joined by a chain of neighbours.
    """

    rank: int
    objective: float | None
    rating: float | None
    replicates: int = 1
    """Seeds of a random simulator: each vehicle of a box has one, under which it is compared with the nominal vehicle. Scores are means."""
    lower: float | None = None
    """Lower end of the interval of the objective, at `replicates.confidence`; null if the noise is unknown, and for the set that leads."""
    upper: float | None = None
    degree: int
    at_least: bool
    radius: float
    failing_at_most: float | None = None
    """Share of the vehicles in the box of `radius` that may break the condition (95 %), whichever of the examined sets is chosen; null if
    no box holds, and for the condition `mean`."""
    recommended: bool
    reason: str | None
    """The reason for the recommendation."""
    region: int
    scores: Annotated[dict[str, Score | None], Spread("score_")]
    parameters: Annotated[dict[str, float | str], Spread()]
    trials: Annotated[list[BoxTrial], JSON_ONLY]


class ValidationRow(Answer):
    """A scenario of the validation (Tables 1 and 2 and Figure 14 of the paper).

    `reducible` parameters have a region without influence; `covered` counts their `effects` (main effects and interactions) that the sets
    cover. Of `drawn` sets (a Latin hypercube, or feasible sets) `bases` qualify (n*_LHS); each is compared with `references` variants
    (n_ref). Variants with |dF| above the scale's tolerance are `wrong`, with any change `different`; R_err is the mean over bases of the
    share of wrong variants, and `lower_95` and `upper_95` limit it, with a confidence of at least 95 %. `histogram` counts variants by
    their difference from the base, in units of `histogram_step`; its ends hold all differences beyond the scale's span.

    For a campaign, `compared` of its `released` predictions were simulated. Errors `beyond` the tolerance (or runs without a result) have a
    share of at least `beyond_lower_95` (Clopper and Pearson). Their expected number among all released predictions is at most `limit` times
    the `inspected` predictions. These fields are null for a map.
    """

    scenario: str
    reducible: int
    effects: int
    covered: int
    drawn: int
    bases: int
    references: int
    compared: int
    wrong: int
    different: int
    error_rate: float | None
    lower_95: float | None
    upper_95: float | None
    released: int | None = None
    inspected: int | None = None
    beyond: int | None = None
    beyond_lower_95: float | None = None
    limit: float | None = None
    histogram: Annotated[dict[int, int], FileForm("numbers", _counts_by_bin)]
    """In files a list of counts, from the largest negative difference to the largest positive one (of comfort: -7 to 7 points)."""
    histogram_step: Annotated[float, JSON_ONLY] = 1.0
    """Difference of neighbouring numbers in the histogram, in units of the score."""


class ImportedRow(Answer):
    """A score or measure from elsewhere, and its value in the stored simulation of the same cell.

    `simulated` and `difference`, the imported value less the simulated one, are null without such a simulation.
    """

    source: str
    date: str
    owner: str | None
    scenario: str
    parameters: Annotated[dict[str, float | str], Spread()]
    kind: Literal["score", "measure"]
    name: str
    unit: str | None
    value: float
    simulated: float | None
    difference: float | None


SolutionPage = Page[Solution]

_ROWS = EvaluationRow, Solution, FrontRow, RobustnessRow, ImportedRow
_OTHER_COLUMNS = frozenset(name for kind in _ROWS for name in kind.model_fields)
_PREFIXES = ("score_", "objective_", "constraint_", "value_", "answer_", "measure_")
