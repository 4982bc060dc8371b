"""Checks the meaning of stored rows: reads documents, parameter sets and reference keys, and recomputes keys.

Complements `storage.consistency` and `storage.invariants`, which check rows without their meaning. Read-only.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import islice

from pydantic import BaseModel, ValidationError
from sqlalchemy import Column, Connection, func, select

from drivecal.bundles.archives import content_digest
from drivecal.bundles.manifest import Manifest
from drivecal.campaigns.resolve.maps import stored_map
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.contracts.specification import CampaignSpecification, EvaluationSpecification
from drivecal.domain.errors import DrivecalError
from drivecal.domain.setups import fingerprint_of
from drivecal.reduction.keys import keys_under
from drivecal.storage import bundles, campaigns
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.tables import campaigns as campaigns_table
from drivecal.storage.engine.tables import influence_maps as influence_maps_table
from drivecal.storage.engine.tables import parameter_sets, runs, setups
from drivecal.storage.maintenance.consistency import CHECKS, INVARIANTS, Check, check_parameter_sets
from drivecal.storage.references import influence_maps, reference_keys

SAMPLED = 10_000
"""Sample size of parameter sets, and of runs over all keys."""
TOLD = 5
"""Problems listed per check."""
_UNREADABLE = (DrivecalError, ValidationError, ValueError, KeyError, TypeError, ArithmeticError, AttributeError)


@dataclass(frozen=True, slots=True)
class VerificationResult:
    """The problems that a check reports; empty if all is well."""

    name: str
    problems: tuple[str, ...]
    seconds: float


def verify(database: Database, *, full: bool) -> Iterator[VerificationResult]:
    """Runs all checks on one snapshot of a database at this drivecal's revision.

    Checks a sample of parameter sets and reference keys, unless `full`. If tables or storage are broken, the other checks are skipped,
    because they would fail for the same reason.
    """
    with database.read() as connection:
        checks: dict[str, Check] = {
            **CHECKS,
            **INVARIANTS,
            "campaigns, setups and maps": _check_meanings,
            "problems": _check_problems,
            "parameter sets": lambda connection: check_parameter_sets(
                connection, _every(connection, parameter_sets.c.id, full=full)
            ),
            "reference keys": lambda connection: _check_reference_keys(connection, _every(connection, runs.c.id, full=full)),
        }
        for name, check in checks.items():
            verdict = _verdict(connection, name, check)
            yield verdict
            if verdict.problems and name in {"tables", "storage"}:
                return


def _verdict(connection: Connection, name: str, check: Check) -> VerificationResult:
    started = time.perf_counter()
    sentences = check(connection)
    first = list(islice(sentences, TOLD))
    more = sum(1 for _ in sentences)
    if more:
        first.append(f"and {more:,} more")
    return VerificationResult(name, tuple(first), time.perf_counter() - started)


def _every(connection: Connection, column: Column[int], *, full: bool) -> int:
    """The sampling interval of rows: a prime, so that no regularity of the rows hides a problem."""
    newest = connection.scalar(select(func.max(column))) or 0
    if full or newest <= SAMPLED:
        return 1
    share = -(-newest // SAMPLED)
    while any(share % divisor == 0 for divisor in range(2, int(share**0.5) + 1)):
        share += 1
    return share


def _check_meanings(connection: Connection) -> Iterator[str]:
    """Checks that specifications, resolutions, counters, maps and setups are readable, and setups match their fingerprints."""
    yield from _unreadable(
        "campaign", connection.scalars(select(campaigns_table.c.id)), lambda identifier: _campaign(connection, identifier)
    )
    ids = connection.scalars(select(influence_maps_table.c.id))
    yield from _unreadable("influence map", ids, lambda identifier: stored_map(influence_maps.get(connection, identifier)))
    for row in connection.execute(select(setups)):
        try:
            fingerprint = fingerprint_of(row.document)
        except _UNREADABLE as error:
            yield f"setup {row.id} cannot be read: {_first_line(error)}"
        else:
            if fingerprint != row.fingerprint:
                yield f"setup {row.id} is not stored under its fingerprint"


def _check_problems(connection: Connection) -> Iterator[str]:
    """Checks that each pushed problem can be read, and is stored under the digest and the name of its content."""
    for digest in bundles.digests(connection):
        try:
            stored, archive = bundles.by_digest(connection, digest), bundles.archive(connection, digest)
            manifest, content = Manifest.model_validate(stored.manifest), content_digest(archive)
        except _UNREADABLE as error:
            yield f"problem {digest} cannot be read: {_first_line(error)}"
            continue
        if content != digest or len(archive) != stored.size:
            yield f"problem {digest} is not stored under the digest and the size of its content"
        if manifest.problem != stored.name:
            yield f"problem {digest} is stored as {stored.name}, and calls itself {manifest.problem}"


def _unreadable(kind: str, ids: Iterable[str], read: Callable[[str], object]) -> Iterator[str]:
    for identifier in list(ids):
        try:
            read(identifier)
        except _UNREADABLE as error:
            yield f"{kind} {identifier} cannot be read: {_first_line(error)}"


def _campaign(connection: Connection, campaign_id: str) -> None:
    campaign = campaigns.get(connection, campaign_id, deleted=True)
    _SPECIFICATIONS[campaign.kind].model_validate(campaign.spec)
    if campaign.resolution is not None:
        resolved_spec(campaign)


_SPECIFICATIONS: dict[campaigns.Kind, type[BaseModel]] = {
    "calibration": CampaignSpecification,
    "evaluation": EvaluationSpecification,
}


def _check_reference_keys(connection: Connection, every: int) -> Iterator[str]:
    """Compares stored reference keys with keys recomputed from the runs."""
    maps = {row.sequence: row.id for row in connection.execute(select(influence_maps_table))}
    scenarios = {row.id: row.scenario for row in connection.execute(select(setups))}
    for index in reference_keys.indexes(connection):
        sequence = index.influence_map_sequence
        if sequence not in maps or index.setup_id not in scenarios:
            yield f"reference keys {index.id} belong to a missing map or setup"
            continue
        scenario = scenarios[index.setup_id]
        try:
            influence_map = stored_map(influence_maps.get(connection, maps[sequence]))
            wrong = reference_keys.wrong_keys(connection, index, partial(keys_under, influence_map, scenario), every)
        except _UNREADABLE as error:
            yield f"reference keys of {scenario} under map {maps[sequence]} cannot be recomputed: {_first_line(error)}"
        else:
            if wrong:
                yield f"{wrong:,} reference keys of {scenario} under map {maps[sequence]} are not those of their runs"


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]
