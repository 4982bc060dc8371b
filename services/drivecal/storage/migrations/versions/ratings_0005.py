"""Ratings that are younger than their runs, and traces."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None

IDENTITY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
MOMENT = sa.DateTime(timezone=True)


def upgrade() -> None:
    """Adds a column; stored rows stay, and every stored rating is as old as its run."""
    op.add_column("ratings", sa.Column("since", IDENTITY, nullable=False, server_default="0"))
    late = sa.text("since > 0")
    op.create_index(op.f("ix_ratings_since"), "ratings", ["since"], sqlite_where=late, postgresql_where=late)
    op.add_column("reference_keys", sa.Column("since", IDENTITY, nullable=False, server_default="0"))
    op.create_table(
        "traces",
        sa.Column("evaluation_id", IDENTITY, nullable=False, autoincrement=False),
        sa.Column("campaign_sequence", IDENTITY, nullable=False),
        sa.Column("content", sa.LargeBinary(), nullable=True),
        sa.Column("created_at", MOMENT, nullable=False),
        sa.ForeignKeyConstraint(["evaluation_id"], ["evaluations.id"], name=op.f("fk_traces_evaluation_id")),
        sa.ForeignKeyConstraint(["campaign_sequence"], ["campaigns.sequence"], name=op.f("fk_traces_campaign_sequence")),
        sa.PrimaryKeyConstraint("evaluation_id", name=op.f("pk_traces")),
    )
