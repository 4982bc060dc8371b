"""Scores of any scale: double precision instead of whole numbers."""

from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None

SCORES = {
    "ratings": ("score",),
    "reference_keys": ("score",),
    "evaluations": ("score", "predicted_score"),
}


def upgrade() -> None:
    """Changes no stored score. SQLite keeps its tables: a real in an INTEGER column stays what it is, to the last bit."""
    if op.get_bind().dialect.name != "postgresql":
        return
    for table, columns in SCORES.items():  # one statement per table, which rewrites it
        changes = ", ".join(f"ALTER COLUMN {column} TYPE double precision" for column in columns)
        op.execute(f"ALTER TABLE {table} {changes}")
