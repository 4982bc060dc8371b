"""Every fault of a submitted document in one answer: those of its fields, and those that only plug-ins and stored campaigns show."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pydantic import BaseModel

from drivecal.api.submission import resolved
from drivecal.campaigns.comparisons.resolve import resolve_comparison
from drivecal.campaigns.resolve.bundle_source import stored_bundles
from drivecal.campaigns.resolve.problem import resolve_evaluation
from drivecal.contracts import strict_json
from drivecal.contracts.comparison import ComparisonSpecification
from drivecal.contracts.input_errors import fitting, validated
from drivecal.contracts.specification import CampaignSpecification, EvaluationSpecification
from drivecal.domain.errors import InvalidInputError, Problem, UnavailableError
from drivecal.storage.engine.database import Database

Check = Callable[[Database, Any], object]

CHECKS: Mapping[type[BaseModel], Check] = {
    CampaignSpecification: resolved,
    ComparisonSpecification: lambda database, document: resolve_comparison(document, stored_bundles(database)),
    EvaluationSpecification: lambda database, document: resolve_evaluation(document, stored_bundles(database)),
}
"""Raise InvalidInputError for a document whose fields fit."""

_SPACE = ("problem", "driving_function", "parameters", "fixed")
_GOALS = ("problem", "evaluator", "catalogue", "weights", "objectives", "constraints")
JUDGED_BY: Mapping[str, Sequence[str]] = {
    "problem": (),
    "optimizer": (),
    "optimizers": (),
    "catalogue": ("problem",),
    "driving_function": ("problem",),
    "evaluator": ("problem",),
    "vehicle": ("problem",),
    "weights": ("problem", "catalogue"),
    "scenario": ("problem", "catalogue"),
    "parameters": ("problem", "driving_function"),
    "fixed": _SPACE,
    "baseline": _SPACE,
    "optimizer.start_sets": _SPACE,
    "objectives": _GOALS,
    "constraints": _GOALS,
    "sensitivity.map": (),
}
"""Sections that a field is judged by. A fault of another field may come from any section that was left out."""


def read(model: type[BaseModel], content: bytes, database: Database) -> BaseModel:
    """Returns a JSON body as a `model`. Raises InvalidInputError with every fault."""
    document = strict_json.loads(content)
    try:
        return validated(model, document, from_outside=True)
    except InvalidInputError as error:
        own = error.problems
    raise InvalidInputError(*own, *_further(model, document, database))


def _further(model: type[BaseModel], document: object, database: Database) -> list[Problem]:
    """Returns the faults of the fields that fit, without those that may come from a missing one."""
    part = fitting(model, document) if model in CHECKS else None
    if part is None:
        return []
    specification, left_out = part
    try:
        CHECKS[model](database, specification)
    except InvalidInputError as error:
        return [problem for problem in error.problems if _stands(problem.field, left_out)]
    except UnavailableError:  # the document's own faults are known without a database
        pass
    return []


def _stands(field: str, left_out: Sequence[str]) -> bool:
    if any(_within(field, missing) or _within(missing, field) for missing in left_out):
        return False
    bases = next((JUDGED_BY[name] for name in sorted(JUDGED_BY, key=len, reverse=True) if _within(field, name)), None)
    return bases is not None and not any(_within(missing, base) for missing in left_out for base in bases)


def _within(field: str, outer: str) -> bool:
    return field == outer or field.startswith((f"{outer}.", f"{outer}["))
