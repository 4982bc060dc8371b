"""What the common reduction left out of a campaign's search space."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Adds the column; of campaigns that ended before, nothing was narrowed."""
    op.add_column("campaigns", sa.Column("narrowed", sa.JSON(), nullable=True))
