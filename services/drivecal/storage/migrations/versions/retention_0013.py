"""Pruned campaigns, the cells of a run, and names of metrics."""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None

NAME = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")


def upgrade() -> None:
    """Only adds; about a minute for ten million cells. Stored metrics keep their form."""
    op.add_column("campaigns", sa.Column("pruned", sa.JSON()))
    for table, column in (("campaigns", "rerun_of"), ("evaluations", "run_id")):
        filled = sa.text(f"{column} IS NOT NULL")
        op.create_index(op.f(f"ix_{table}_{column}"), table, [column], sqlite_where=filled, postgresql_where=filled)
    listed = sa.text("kind <> 'evaluation' AND parent_sequence IS NULL")
    op.create_index(op.f("ix_campaigns_listed"), "campaigns", ["sequence"], sqlite_where=listed, postgresql_where=listed)
    op.create_table(
        "metric_names",
        sa.Column("digest", NAME, nullable=False),
        sa.Column("names", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("digest", name=op.f("pk_metric_names")),
    )
