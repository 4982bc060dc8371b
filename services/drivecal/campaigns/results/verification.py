"""Whether what is stored still means what it meant: documents, parameter sets and reference keys are read, and keys made anew.

Beside `storage.consistency` and `storage.invariants`, which know rows and not what they mean. Only reads.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import islice

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ValidationError
from sqlalchemy import Column, Connection, func, select

from drivecal.campaigns.comparisons.resolve import runs_of
from drivecal.campaigns.resolve.maps import stored_map
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.contracts.comparison import ComparisonSpecification
from drivecal.contracts.specification import CampaignSpecification, EvaluationSpecification
from drivecal.domain.errors import DrivecalError
from drivecal.domain.influence import InfluenceMap
from drivecal.domain.setups import Setup
from drivecal.reduction.keys import ReferenceKeys
from drivecal.storage import campaigns, comparisons
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.tables import campaigns as campaigns_table
from drivecal.storage.engine.tables import influence_maps as influence_maps_table
from drivecal.storage.engine.tables import parameter_sets, runs, setups
from drivecal.storage.maintenance.consistency import CHECKS, Check, check_parameter_sets
from drivecal.storage.maintenance.invariants import INVARIANTS
from drivecal.storage.references import influence_maps, reference_keys

SAMPLED = 10_000
"""Parameter sets, and runs of all keys, that are looked at where not all are."""
TOLD = 5
"""Of the sentences of a check that found many."""
_UNREADABLE = (DrivecalError, ValidationError, ValueError, KeyError, TypeError, ArithmeticError, AttributeError)


@dataclass(frozen=True, slots=True)
class VerificationResult:
    """What a check found; nothing where all is well."""

    name: str
    problems: tuple[str, ...]
    seconds: float


def verify(database: Database, *, full: bool) -> Iterator[VerificationResult]:
    """Carries out all checks on one snapshot of a database at this drivecal's revision. Of parameter sets and reference keys a sample,
    unless `full`. Where tables or storage are broken, the other checks are left out: they would stumble over the same."""
    with database.read() as connection:
        checks: dict[str, Check] = {
            **CHECKS,
            **INVARIANTS,
            "campaigns, setups and maps": _check_meanings,
            "parameter sets": lambda one: check_parameter_sets(one, _every(one, parameter_sets.c.id, full=full)),
            "reference keys": lambda one: _check_reference_keys(one, _every(one, runs.c.id, full=full)),
        }
        for name, check in checks.items():
            verdict = _verdict(connection, name, check)
            yield verdict
            if verdict.problems and name in {"tables", "storage"}:
                return


def _verdict(connection: Connection, name: str, check: Check) -> VerificationResult:
    started = time.perf_counter()
    found = check(connection)
    told = list(islice(found, TOLD))
    more = sum(1 for _ in found)
    if more:
        told.append(f"and {more:,} more")
    return VerificationResult(name, tuple(told), time.perf_counter() - started)


def _every(connection: Connection, column: Column[int], *, full: bool) -> int:
    """How many rows stand for one that is looked at; a prime, so that no regularity of the rows hides anything."""
    newest = connection.scalar(select(func.max(column))) or 0
    if full or newest <= SAMPLED:
        return 1
    share = -(-newest // SAMPLED)
    while any(share % divisor == 0 for divisor in range(2, int(share**0.5) + 1)):
        share += 1
    return share


def _check_meanings(connection: Connection) -> Iterator[str]:
    """Specifications, resolutions, counters, maps and setups can be read; setups are stored under their fingerprints."""
    yield from _unreadable("campaign", connection.scalars(select(campaigns_table.c.id)), lambda one: _campaign(connection, one))
    ids = connection.scalars(select(influence_maps_table.c.id))
    yield from _unreadable("influence map", ids, lambda one: stored_map(influence_maps.get(connection, one)))
    for row in connection.execute(select(setups)):
        try:
            fingerprint = Setup.from_document(row.document).fingerprint
        except _UNREADABLE as error:
            yield f"setup {row.id} cannot be read: {_first_line(error)}"
        else:
            if fingerprint != row.fingerprint:
                yield f"setup {row.id} is not stored under its fingerprint"


def _unreadable(kind: str, ids: Iterable[str], read: Callable[[str], object]) -> Iterator[str]:
    for identifier in list(ids):
        try:
            read(identifier)
        except _UNREADABLE as error:
            yield f"{kind} {identifier} cannot be read: {_first_line(error)}"


def _campaign(connection: Connection, campaign_id: str) -> None:
    campaign = campaigns.get(connection, campaign_id)
    _SPECIFICATIONS[campaign.kind].model_validate(campaign.spec)
    if campaign.resolution is not None:
        resolved_spec(campaign)
    if campaign.kind == "comparison":
        _check_runs(connection, campaign)


def _check_runs(connection: Connection, campaign: StoredCampaign) -> None:
    """Raises ValueError where a comparison has other runs than its specification says."""
    wanted = [run.specification.name for run in runs_of(ComparisonSpecification.model_validate(campaign.spec))]
    found = comparisons.names_of(connection, campaign.sequence)
    if found != wanted:
        raise ValueError(f"it has {len(found):,} runs, and its specification says {len(wanted):,}, or others")


_SPECIFICATIONS: dict[campaigns.Kind, type[BaseModel]] = {
    "calibration": CampaignSpecification,
    "comparison": ComparisonSpecification,
    "evaluation": EvaluationSpecification,
}


def _check_reference_keys(connection: Connection, every: int) -> Iterator[str]:
    """Reference keys are those that would be made from the runs today."""
    maps = {row.sequence: row.id for row in connection.execute(select(influence_maps_table))}
    scenarios = {row.id: row.scenario for row in connection.execute(select(setups))}
    for index in reference_keys.indexes(connection):
        sequence = index.influence_map_sequence
        if sequence not in maps or index.setup_id not in scenarios:
            yield f"reference keys {index.id} are of a map or setup that is not there"
            continue
        scenario = scenarios[index.setup_id]
        try:
            found = stored_map(influence_maps.get(connection, maps[sequence]))
            wrong = reference_keys.wrong_keys(connection, index, partial(_keys_of, found, scenario), every)
        except _UNREADABLE as error:
            yield f"reference keys of {scenario} under map {maps[sequence]} cannot be made anew: {_first_line(error)}"
        else:
            if wrong:
                yield f"{wrong:,} reference keys of {scenario} under map {maps[sequence]} are not those of their runs"


def _keys_of(influence_map: InfluenceMap, scenario: str, names: tuple[str, ...], values: npt.NDArray[np.int64]) -> list[bytes]:
    return ReferenceKeys(influence_map, scenario, names).keys(values)


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]
