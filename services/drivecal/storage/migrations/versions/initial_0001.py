"""All tables of `storage.engine.tables`.

No release has these tables yet, so a change to `tables.py` changes this revision and no other: its name has a digest of the columns and
indexes, and a database with other ones is noticed. A release freezes them: this file then lists the tables of that release, and each
later change is a revision of its own.
"""

from hashlib import sha256

from alembic import op

from drivecal.storage.engine.tables import metadata

_COLUMNS = [(str(each), type(each.type).__name__, each.nullable) for table in metadata.sorted_tables for each in table.columns]
_INDEXES = sorted(str(index.name) for table in metadata.sorted_tables for index in table.indexes)
revision = f"0001_{sha256(repr((_COLUMNS, _INDEXES)).encode()).hexdigest()[:12]}"
down_revision = None


def upgrade() -> None:
    """Creates the tables."""
    metadata.create_all(op.get_bind())
