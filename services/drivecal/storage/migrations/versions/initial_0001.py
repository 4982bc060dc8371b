"""All tables of `storage.engine.tables`.

No release has these tables yet, so a change to `tables.py` changes this revision and no other. A release freezes them: this file then lists
the tables of that release, and each later change is a revision of its own.
"""

from alembic import op

from drivecal.storage.engine.tables import metadata

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Creates the tables."""
    metadata.create_all(op.get_bind())
