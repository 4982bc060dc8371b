"""Admission of requests: each Idempotency-Key once, limits of the queue, and of the users' influence maps and problems."""

from hashlib import sha256

from sqlalchemy import Connection, func, select, text

from drivecal.bundles.installed import installed_problems
from drivecal.domain.errors import ConflictError, OverloadError, Problem, TooLargeError
from drivecal.storage.bundles import add, is_stored
from drivecal.storage.engine.tables import bundles, campaigns, influence_maps

KEY = 0x64726332
"""First key of the advisory lock on PostgreSQL; the second is a hash of the schema."""
RETRY_SECONDS = 30
MOST_MAPS = 1_000
"""Influence maps of users that are kept."""


def alone(connection: Connection) -> None:
    """Keeps submissions, requests of traces and deletions apart until the transaction ends. Call it before other locks and before
    the reads that decide."""
    if connection.dialect.name == "postgresql":  # on SQLite a transaction that writes is alone from its start
        connection.execute(text("SELECT pg_advisory_xact_lock(:key, hashtext(current_schema()))"), {"key": KEY})


def admit(connection: Connection, most: int, idempotency_key: str | None, count: int = 1) -> None:
    """Raises OverloadError if more than `most` campaigns and evaluations would wait to be started with these `count`. The caller inserts in
    the same transaction: until its end no other request is admitted, so that requests at once cannot overshoot, and no campaign is deleted.
    So what a request names is checked after this call.

    A request whose key is known inserts nothing and is always admitted.
    """
    alone(connection)
    if idempotency_key is not None:
        known = select(campaigns.c.sequence).where(campaigns.c.idempotency_key == idempotency_key)
        if connection.execute(known).first() is not None:
            return
    open_ones = select(func.count()).select_from(campaigns).where(campaigns.c.ended_at.is_(None))
    waiting = connection.scalar(open_ones.where(campaigns.c.started_at.is_(None))) or 0
    if waiting + count > most:
        message = f"{waiting:,} campaigns and evaluations wait, as many as this server takes; try again later, or cancel some"
        raise OverloadError(message, RETRY_SECONDS)


def add_installed(connection: Connection) -> None:
    """Stores the installed problems, so that they are listed and shown like pushed ones, and outlive an upgrade."""
    alone(connection)
    for problem in installed_problems().values():
        if not is_stored(connection, problem.digest):
            document, name = problem.manifest.model_dump(mode="json"), problem.manifest.problem
            add(connection, digest=problem.digest, name=name, manifest=document, archive=problem.archive)


def key_of(owner: str | None, key: str) -> str:
    """Returns what is stored for an Idempotency-Key: the keys of two owners are different ones."""
    return key if owner is None else sha256(f"{owner}\0{key}".encode()).hexdigest()


def earlier(connection: Connection, body_digest: str | None, *keys: str | None) -> int | None:
    """Returns the number of the first campaign that an earlier request queued with one of these keys, None without one.

    Raises ConflictError if that request was another one.
    """
    given = [key for key in keys if key is not None]
    if not given:
        return None
    table = campaigns.c
    query = select(table.sequence, table.id, table.body_digest).where(table.idempotency_key.in_(given))
    row = connection.execute(query.order_by(table.sequence).limit(1)).one_or_none()
    if row is not None and row.body_digest != body_digest:
        raise ConflictError(
            f"the Idempotency-Key was used for another request, which made campaign {row.id}; use a new key for a new request"
        )
    return None if row is None else row.sequence


def admit_map(connection: Connection, source: str) -> None:
    """Raises TooLargeError if MOST_MAPS influence maps of a source are kept already; otherwise as `admit`."""
    alone(connection)
    kept = connection.scalar(select(func.count()).where(influence_maps.c.source == source)) or 0
    if kept >= MOST_MAPS:
        instead = "use one of those (`drivecal influence-maps list`)"
        raise TooLargeError(Problem("", f"{kept:,} posted influence maps are kept, as many as this server takes", instead))


def admit_problem(connection: Connection, digest: str, most: int) -> None:
    """Raises TooLargeError if `most` bundles are kept already, none of them with this digest; otherwise as `admit`."""
    alone(connection)
    own = [problem.digest for problem in installed_problems().values()]
    kept = connection.scalar(select(func.count()).where(bundles.c.digest.not_in(own))) or 0
    if kept >= most and not is_stored(connection, digest):
        instead = "let the server keep more (DRIVECAL_PUSHED_PROBLEMS)"
        raise TooLargeError(Problem("", f"{kept:,} pushed problems are kept, as many as this server takes", instead))
