"""Cells by stage in a table of their own."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None

IDENTITY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
COLUMNS = {1: "sensitivity_cells", 2: "cells", 3: "robustness_cells", 4: "validation_cells"}
"""Columns by the number of the stage."""


def upgrade() -> None:
    """Moves the counts of every stage that has begun; no count changes."""
    op.create_table(
        "campaign_stages",
        sa.Column("campaign_sequence", IDENTITY, autoincrement=False, nullable=False),
        sa.Column("stage", sa.SmallInteger(), autoincrement=False, nullable=False),
        sa.Column("cells", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(
            ["campaign_sequence"], ["campaigns.sequence"], name=op.f("fk_campaign_stages_campaign_sequence")
        ),
        sa.PrimaryKeyConstraint("campaign_sequence", "stage", name=op.f("pk_campaign_stages")),
    )
    for number, column in COLUMNS.items():
        op.execute(
            f"INSERT INTO campaign_stages (campaign_sequence, stage, cells) SELECT sequence, {number}, {column} FROM campaigns"  # noqa: S608  # no input
            f" WHERE {column} IS NOT NULL"
        )
    for column in COLUMNS.values():
        op.drop_column("campaigns", column)
