"""Campaigns that belong to a comparison, and the rating of the best set by iteration."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

IDENTITY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Adds; nothing that is stored changes."""
    parent = sa.ForeignKey("campaigns.sequence", name=op.f("fk_campaigns_parent_sequence"))
    inline = op.get_bind().dialect.name == "sqlite"  # which takes no constraint afterwards, and gives this one no name
    op.add_column("campaigns", sa.Column("parent_sequence", IDENTITY, parent, nullable=True), inline_references=inline)
    runs = sa.text(
        "parent_sequence IS NOT NULL"
    )  # a full index would be taken for "campaigns without a parent", which most are
    op.create_index(
        op.f("ix_campaigns_parent_sequence"), "campaigns", ["parent_sequence"], sqlite_where=runs, postgresql_where=runs
    )
    op.add_column("generations", sa.Column("rating", sa.Float(), nullable=True))
