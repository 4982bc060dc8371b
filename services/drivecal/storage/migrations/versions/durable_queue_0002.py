"""Leases, events and priorities of a durable queue, and studies of the stages after the calibration."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

IDENTITY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
NAME = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")
MOMENT = sa.DateTime(timezone=True)


def upgrade() -> None:
    """Adds; nothing that is stored changes."""
    op.add_column("campaigns", sa.Column("priority", sa.Integer(), nullable=False, server_default="0"))
    op.add_column("campaigns", sa.Column("revision", sa.Integer(), nullable=False, server_default="0"))
    op.add_column("campaigns", sa.Column("robustness_cells", sa.JSON(), nullable=True))
    op.add_column("campaigns", sa.Column("validation_cells", sa.JSON(), nullable=True))
    op.add_column("evaluations", sa.Column("detail", sa.Text(), nullable=True))
    op.add_column("evaluations", sa.Column("proven_by", IDENTITY, nullable=True))
    op.add_column("evaluations", sa.Column("proof_agrees", sa.Boolean(), nullable=True))
    op.add_column("processes", sa.Column("term", sa.Integer(), nullable=False, server_default="0"))
    op.create_table(
        "leases",
        sa.Column("evaluation_id", IDENTITY, nullable=False, autoincrement=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("term", sa.Integer(), nullable=False),
        sa.Column("expires_at", MOMENT, nullable=False),
        sa.ForeignKeyConstraint(["evaluation_id"], ["evaluations.id"], name=op.f("fk_leases_evaluation_id")),
        sa.PrimaryKeyConstraint("evaluation_id", name=op.f("pk_leases")),
    )
    op.create_table(
        "studies",
        sa.Column("campaign_sequence", IDENTITY, nullable=False, autoincrement=False),
        sa.Column("stage", sa.SmallInteger(), nullable=False, autoincrement=False),
        sa.Column("document", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(["campaign_sequence"], ["campaigns.sequence"], name=op.f("fk_studies_campaign_sequence")),
        sa.PrimaryKeyConstraint("campaign_sequence", "stage", name=op.f("pk_studies")),
    )
    op.create_table(
        "events",
        sa.Column("id", IDENTITY, nullable=False),
        sa.Column("campaign_sequence", IDENTITY, nullable=False),
        sa.Column("kind", NAME, nullable=False),
        sa.Column("data", sa.JSON(), nullable=False),
        sa.Column("created_at", MOMENT, nullable=False),
        sa.ForeignKeyConstraint(["campaign_sequence"], ["campaigns.sequence"], name=op.f("fk_events_campaign_sequence")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_events")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_events_campaign_sequence_id"), "events", ["campaign_sequence", "id"])
    op.create_index(op.f("ix_events_created_at"), "events", ["created_at"])
