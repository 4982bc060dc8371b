"""Database URLs: parses a user's URL for SQLAlchemy, and masks it for messages."""

import os
from pathlib import Path

from sqlalchemy import URL, make_url
from sqlalchemy.exc import ArgumentError

from drivecal.domain.errors import DatabaseError

EXAMPLES = "give e.g. sqlite:////home/me/drivecal.db or postgresql://user:password@host/database"


def parse(url: str) -> URL:
    """Returns the URL with its driver. Raises DatabaseError if it names no database file or server that drivecal can use."""
    try:
        parsed = make_url(url)
    except (ArgumentError, ValueError) as error:
        # The message must not repeat the URL: it may hold a password.
        raise DatabaseError(f"the database URL cannot be read; {EXAMPLES}") from error
    match parsed.get_backend_name():
        case "sqlite":
            if parsed.database in {None, "", ":memory:"} or "mode" in parsed.query or "uri" in parsed.query:
                raise DatabaseError(f"several processes share the database, so SQLite needs a plain file; {EXAMPLES}")
            return parsed.set(drivername="sqlite+pysqlite")
        case "postgresql" | "postgres":
            return parsed.set(drivername="postgresql+psycopg")
        case backend:
            raise DatabaseError(f"drivecal cannot use {backend!r} as its database; {EXAMPLES}")


def sqlite_file(url: URL) -> Path | None:
    """Returns the file of an SQLite database, which has one lock however many links lead to it; None for PostgreSQL."""
    file = Path(url.database or "")
    return None if url.get_backend_name() != "sqlite" else Path(os.path.realpath(file)) if file.is_symlink() else file


def shown(url: URL) -> str:
    """Returns the URL for messages: with a masked password, and of the options only the host, because others may be passwords."""
    file = sqlite_file(url)
    if file is not None:
        return str(file)
    host = {name: value for name, value in url.query.items() if name == "host"}
    return url.set(drivername="postgresql", query=host).render_as_string(hide_password=True)
