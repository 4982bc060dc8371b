"""Submission of campaigns and evaluations: checked, once per Idempotency-Key, whole or not at all."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import isclose
from typing import Any

from pydantic import BaseModel
from sqlalchemy import Connection

from drivecal.analysis.goals import SCORE
from drivecal.analysis.solutions import EvaluatedSet
from drivecal.api.dependencies import Limits
from drivecal.api.expectation import checked, checked_comparison, compared_map, refuse_without, stored_parts
from drivecal.api.responses import state_of
from drivecal.api.tables.ranking import solution_pages
from drivecal.campaigns.comparison import keys_of, tag_of
from drivecal.campaigns.resolve.maps import is_outdated, warnings_of
from drivecal.campaigns.resolve.optimizer import BEGINNINGS
from drivecal.campaigns.resolve.problem import CalibrationProblem, EvaluationProblem, resolve_evaluation
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.resolve.spaces import given_set
from drivecal.campaigns.resolve.workbench import moved, stored_bundles
from drivecal.campaigns.results.front import StoredRanking
from drivecal.contracts.comparison import ComparisonSpecification
from drivecal.contracts.input_errors import validated
from drivecal.contracts.specification import (
    CampaignSpecification,
    EvaluationSpecification,
    ReductionSpecification,
    RerunSpecification,
)
from drivecal.domain.errors import ConflictError, Diagnostics, InvalidInputError, NotFoundError, Problem
from drivecal.domain.setups import canonical_json, digest
from drivecal.optimizers.built_in import External
from drivecal.storage import admission, campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.references import influence_maps, parameter_sets
from drivecal.storage.references.influence_maps import StoredInfluenceMap

TRIED = 1_000
"""Best sets of a campaign among which one is looked for that its rerun's ranges and constraints allow."""


@dataclass(frozen=True, slots=True)
class Asked:
    """A request by the `digest` of all that tells requests apart, the stored form of its Idempotency-Key, and its owner."""

    digest: str
    key: str | None
    owner: str | None

    @classmethod
    def of(cls, path: str, body: BaseModel, key: str | None, owner: str | None) -> "Asked":
        """Returns the identity of a request, its path and body."""
        identity = canonical_json({"path": path, "body": body.model_dump(mode="json")})
        return cls(digest(identity.encode()), None if key is None else admission.key_of(owner, key), owner)

    @property
    def columns(self) -> dict[str, Any]:
        """Columns of its campaign."""
        return {"idempotency_key": self.key, "body_digest": self.digest, "owner": self.owner}


def submit(
    database: Database, limits: Limits, specification: CampaignSpecification, key: str | None, owner: str | None = None
) -> StoredCampaign:
    """Queues a campaign of an owner, the name of a token.

    Raises InvalidInputError if it cannot run, TooLargeError, and OverloadError if the queue is full.
    """
    asked = Asked.of("campaigns", specification, key, owner)
    if (earlier := accepted_before(database, asked.digest, asked.key)) is not None:
        return earlier
    problem = checked(database, limits, specification)
    with database.transaction() as connection:
        return _queue(connection, limits, problem, asked)


def accepted_before(database: Database, body_digest: str, *keys: str | None) -> StoredCampaign | None:
    """Returns the first campaign that the same request made before, None without one. It is looked up before the request is checked: what
    it names may be gone. Raises ConflictError if a key belongs to another request."""
    with database.read() as connection:
        sequence = admission.earlier(connection, body_digest, *keys)
        return None if sequence is None else campaigns.by_sequence(connection, sequence)


def rerun(
    database: Database, limits: Limits, first_id: str, changes: RerunSpecification, key: str | None, owner: str | None = None
) -> StoredCampaign:
    """Queues an ended campaign again with `changes`. Raises ConflictError before its end, NotFoundError, and like `submit`."""
    first_id = database.query(campaigns.get, first_id, deleted=True).id  # however it was abbreviated, the request is the same
    asked = Asked.of(f"campaigns/{first_id}/rerun", changes, key, owner)
    if (earlier := accepted_before(database, asked.digest, asked.key)) is not None:
        return earlier
    with database.read() as connection:
        first = campaigns.get(connection, first_id)
        used = None if first.influence_map_id is None else influence_maps.get(connection, first.influence_map_id)
    if first.kind != "calibration":
        raise ConflictError(f"{first_id} is a single evaluation, which has no weights; evaluate another set")
    if not first.state.ended:
        raise ConflictError(f"campaign {first_id} is {state_of(first)}; rerun it when it has ended, or cancel it first")
    document = _changed(first, used, changes)
    problem = checked(database, limits, validated(CampaignSpecification, document), again=True)
    is_rated = problem.bench.evaluator is not None and _names_score(problem)  # else a formula, which objectives name
    if changes.evaluator is not None and document.get("objectives") and not is_rated:
        message = "it changes nothing for a campaign with `objectives`, which keep the scores that they name"
        raise InvalidInputError(Problem("evaluator", message, "leave it out, or submit a campaign with other `objectives`"))
    names = [stored_bundles(database)(push).manifest.problem for push in (first.spec["problem"], problem.specification.problem)]
    if names[0] != names[1]:
        raise InvalidInputError(Problem("problem", f"the first campaign's is {names[0]}", f"push that, or submit {names[1]}"))
    others = database.query(moved, first.spec["problem"], problem.specification.problem)
    if held := [name for name in others if f'"{name}"' in canonical_json(document)]:
        raise InvalidInputError(Problem("problem", f"{', '.join(held)} mean other curves there", "submit lists of values"))
    if used is not None and used.basis is not None and is_outdated(used, problem):
        document["sensitivity"] = used.basis["sensitivity"]  # made again, from stored runs if only ratings are others
        problem = checked(database, limits, validated(CampaignSpecification, document), again=True)
    best = None if others else _best_before(database, first, problem)
    if best is not None:
        document["optimizer"] = {**document["optimizer"], "start_sets": [*document["optimizer"].get("start_sets", []), best]}
        problem = checked(database, limits, validated(CampaignSpecification, document), again=True)
    with database.transaction() as connection:
        return _queue(connection, limits, problem, asked, rerun_of=first.id)


def _names_score(problem: CalibrationProblem) -> bool:
    return SCORE in {goal.value.key for goal in (*problem.goals.objectives, *problem.goals.bounds)}


def _best_before(database: Database, first: StoredCampaign, problem: CalibrationProblem) -> dict[str, Any] | None:
    """Returns the set of the first campaign that is the best in its rerun; None if the search knows all stored sets, as the default one
    does after an equal push, or is to know none, has no room for it, ranks sets as the first one did, or can rank none before it begins."""
    chosen, wanted, weights = problem.optimization, problem.specification, problem.weights
    if chosen is None or isinstance(chosen.plugin, External) or wanted.reduction.isolated:
        return None
    if len(problem.start_sets) >= chosen.population if chosen.has_populations else first.spec["problem"] == wanted.problem:
        return None
    theirs = resolved_spec(first)
    is_scored = theirs.evaluator == problem.bench.evaluator_id
    alike = theirs.weights.keys() == weights.keys() and all(isclose(theirs.weights[name], weights[name]) for name in weights)
    if (is_scored and alike and first.spec["problem"] == wanted.problem) or not weights.keys() <= theirs.weights.keys():
        return None
    ranked: Sequence[EvaluatedSet] = ()
    if is_scored or not _names_score(problem):
        asked = replace(theirs, weights=weights, goals=problem.goals)
        ranked = StoredRanking(database, first, asked).sets.best_first()
    elif problem.goals.is_weighted_score:
        text = ",".join(f"{name}={weights.get(name, 0.0)!r}" for name in theirs.weights)
        with suppress(InvalidInputError):  # a learned score ranks nothing before the rerun
            ranked = solution_pages(StoredRanking(database, first, theirs), text, f"{wanted.evaluator}@{wanted.problem}").ranked
    sets = database.query(parameter_sets.load, [each.parameter_set for each in ranked[:TRIED]])
    shapes, space = problem.bench.bundle.manifest.shapes, problem.search_constraints
    made = ((each, given_set(sets[each.parameter_set].floats, space, "", Diagnostics(), shapes)) for each in ranked[:TRIED])
    place, best = next(((each.iteration, fitting) for each, fitting in made if fitting is not None), (0, None))
    if best is None or best in problem.start_sets or (place == 0 and _is_drawn_again(database, first, wanted)):
        return None
    return dict(best.floats)


def _is_drawn_again(database: Database, first: StoredCampaign, wanted: CampaignSpecification) -> bool:
    """Returns whether the start population of a rerun is that of the first campaign."""
    before, after = first.spec, wanted.model_dump(mode="json")
    search, searched = ({**(spec["optimizer"] or {}), "iterations": 0} for spec in (before, after))
    with suppress(NotFoundError):
        first_push, push = (stored_bundles(database)(spec["problem"]).manifest for spec in (before, after))
        alike = all(getattr(first_push, name) == getattr(push, name) for name in ("parameters", "constraints", "baseline"))
        alike &= all(before.get(name) == after.get(name) for name in ("parameters", "fixed", "baseline"))
        return alike and search == searched
    return False


def compare(database: Database, limits: Limits, wanted: ComparisonSpecification, key: str, owner: str | None = None) -> str:
    """Queues the campaigns of a comparison, all or none, and returns their tag. Each has a key of its own, made of the Idempotency-Key
    `key`: the same request queues none again as long as one of them is not deleted.

    Raises InvalidInputError if one cannot run, TooLargeError, and OverloadError if the queue has no room for all.
    """
    asked, key = Asked.of("comparisons", wanted, None, owner), admission.key_of(owner, key)
    keys, tag = keys_of(wanted, key), tag_of(wanted.name, key)
    if accepted_before(database, asked.digest, *keys) is not None:
        return tag
    problem = checked_comparison(database, limits, wanted)
    with database.transaction() as connection:
        admission.alone(connection)
        if admission.earlier(connection, asked.digest, *keys) is not None:
            return tag
        admission.admit(connection, limits.settings.queued_campaigns, None, len(problem.runs))
        map_id = compared_map(connection, problem)
        for own, run in zip(keys, problem.runs, strict=True):
            stored = campaigns.insert(
                connection,
                name=run.name,
                spec=run.model_dump(mode="json"),
                tags=[tag],
                influence_map_id=None if run.sensitivity is None else map_id,
                priority=run.priority,
                **replace(asked, key=own).columns,
            )
            _pinned(connection, stored, problem.problems[0])
    return tag


def evaluate(
    database: Database, limits: Limits, specification: EvaluationSpecification, key: str | None, owner: str | None = None
) -> StoredCampaign:
    """Queues a single evaluation. Raises InvalidInputError if it cannot run, OverloadError if the queue is full."""
    asked = Asked.of("evaluations", specification, key, owner)
    if (earlier := accepted_before(database, asked.digest, asked.key)) is not None:
        return earlier
    problem = resolve_evaluation(specification, stored_bundles(database))
    refuse_without(limits, problem.bench)
    with database.transaction() as connection:
        admission.admit(connection, limits.settings.queued_campaigns, asked.key)
        stored = campaigns.insert(
            connection,
            name="evaluation",
            spec=problem.specification.model_dump(mode="json"),
            kind="evaluation",
            **asked.columns,
            notes=problem.notes,
        )
        return _pinned(connection, stored, problem)


def _queue(
    connection: Connection, limits: Limits, problem: CalibrationProblem, asked: Asked, rerun_of: str | None = None
) -> StoredCampaign:
    specification = problem.specification
    admission.admit(connection, limits.settings.queued_campaigns, asked.key)
    first = None if rerun_of is None else campaigns.get(connection, rerun_of)  # it may have been deleted since it was read
    used = stored_parts(connection, problem)
    analysed = None if first is None or used is None or used != first.influence_map_id else first.spec["sensitivity"]
    stored = campaigns.insert(
        connection,
        name=specification.name,
        spec=specification.model_dump(mode="json"),
        influence_map_id=used,
        rerun_of=rerun_of,
        likeness=_likeness(problem, analysed),
        priority=specification.priority,
        **asked.columns,
        notes=warnings_of(connection, problem, used, now()),
    )
    return _pinned(connection, stored, problem)


def _likeness(problem: CalibrationProblem, analysed: Any) -> str:
    """Returns a digest of everything that decides a search; equal weights are equal, however they are written. `analysed`: the analysis
    of an earlier campaign that made the map of a rerun."""
    document = problem.specification.model_dump(mode="json", exclude={"name", "priority", "weights"})
    document |= {} if analysed is None else {"sensitivity": analysed}
    return digest(canonical_json(document | {"weights": dict(problem.weights)}).encode())


def _pinned(connection: Connection, stored: StoredCampaign, problem: CalibrationProblem | EvaluationProblem) -> StoredCampaign:
    """Stores the resolution of a campaign at once. If plug-ins run it, which may change until it starts, its start stores it again."""
    if stored.resolution is not None:
        return stored
    campaigns.set_resolution(connection, stored.sequence, problem.resolution())
    return campaigns.by_sequence(connection, stored.sequence)


def _changed(first: StoredCampaign, used: StoredInfluenceMap | None, changes: RerunSpecification) -> dict[str, Any]:
    """Returns the first campaign's specification with the changes and the influence map that it `used`."""
    given_in = changes.model_dump(mode="json", include={"problem", "evaluator", "budget"}, exclude_none=True)
    document: dict[str, Any] = dict(first.spec) | given_in | {"weights": dict(changes.weights)}
    differing = [*given_in, *(each for each in ("optimizer", "reduction") if getattr(changes, each) is not None)]
    why = ", ".join([*(["weights"] if changes.weights != first.spec.get("weights") else []), *differing])
    document["name"] = changes.name or f"{re.sub(r' [(]rerun[^()]*[)]$', '', first.name)[:130]} (rerun{why and f': {why}'})"
    for section in ("optimizer", "reduction"):
        given: BaseModel | None = getattr(changes, section)
        if given is not None:
            document[section] = _merged(document[section], given.model_dump(mode="json", exclude_unset=True))
    is_default = document["reduction"].get("mode") == ReductionSpecification().mode and document["sensitivity"] is None
    if (
        changes.evaluator is not None
        and is_default
        and (changes.reduction is None or "mode" not in changes.reduction.model_fields_set)
    ):
        # the mode is a default, which constraints may forbid now: they keep the scores that they name
        document["reduction"] = {name: value for name, value in document["reduction"].items() if name != "mode"}
    if used is not None:
        document["sensitivity"] = {"map": used.id}
    return document


def _merged(before: Mapping[str, Any] | None, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Returns merged settings. For another kind of optimizer, only the sets that a search begins with are kept."""
    if before is not None and changes.get("kind", before.get("kind")) != before.get("kind"):
        before = {name: before[name] for name in BEGINNINGS if name in before}
    return {**(before or {}), **changes}
