"""Predicted answers: lots, and the prediction of each cell."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None

IDENTITY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
NAME = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")


def upgrade() -> None:
    """Only adds; no stored campaign has predictions."""
    op.create_table(
        "lots",
        sa.Column("id", IDENTITY, nullable=False),
        sa.Column("campaign_sequence", IDENTITY, nullable=False),
        sa.Column("iteration", sa.Integer(), nullable=False),
        sa.Column("individual", sa.Integer(), nullable=False),
        sa.Column("scenario", NAME, nullable=False),
        sa.Column("size", sa.Integer(), nullable=False),
        sa.Column("sample", sa.Integer(), nullable=False),
        sa.Column("acceptance", sa.Integer(), nullable=False),
        sa.Column("tolerance", sa.Float(), nullable=False),
        sa.Column("aoql", sa.Float(), nullable=False),
        sa.Column("known", sa.Integer(), nullable=False),
        sa.Column("seconds", sa.Float(), nullable=False),
        sa.Column("verdict", NAME),
        sa.Column("errors", sa.Integer()),
        sa.ForeignKeyConstraint(["campaign_sequence"], ["campaigns.sequence"], name=op.f("fk_lots_campaign_sequence")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_lots")),
        sa.UniqueConstraint(
            "campaign_sequence",
            "iteration",
            "individual",
            "scenario",
            name=op.f("uq_lots_campaign_sequence_iteration_individual_scenario"),
        ),
        sqlite_autoincrement=True,
    )
    op.add_column("campaigns", sa.Column("released", sa.JSON()))
    op.add_column("campaigns", sa.Column("secret", sa.LargeBinary()))
    for count in ("predicted", "sampled"):
        op.add_column("generations", sa.Column(count, sa.Integer(), nullable=False, server_default="0"))
    for column in (
        sa.Column("lot", IDENTITY),
        sa.Column("confidence", sa.Float()),
        sa.Column("predicted_score", sa.Integer()),
        sa.Column("predicted_rating", sa.Float()),
        sa.Column("sampled", sa.Boolean(), nullable=False, server_default=sa.false()),
    ):
        op.add_column("evaluations", column)
