"""Wall-clock time of runs whose simulators may wait."""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Only adds. Null in stored runs, in which it was not measured."""
    op.add_column("runs", sa.Column("wall_milliseconds", sa.Float(), nullable=True))
