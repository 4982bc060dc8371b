"""Tags, comments and archived campaigns, deleted ones, and saved views of the page."""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None

IDENTITY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
NAME = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")


def upgrade() -> None:
    """Only adds. Stored campaigns have no tag and are neither archived nor deleted."""
    op.add_column("campaigns", sa.Column("tags", sa.JSON(), nullable=False, server_default="[]"))
    op.add_column("campaigns", sa.Column("comment", sa.Text(), nullable=False, server_default=""))
    op.add_column("campaigns", sa.Column("archived_at", sa.DateTime(timezone=True), nullable=True))
    op.add_column("campaigns", sa.Column("deleted_at", sa.DateTime(timezone=True), nullable=True))
    op.create_table(
        "saved_views",
        sa.Column("sequence", IDENTITY, nullable=False),
        sa.Column("id", NAME, nullable=False),
        sa.Column("campaign", NAME, nullable=False),
        sa.Column("name", NAME, nullable=False),
        sa.Column("address", sa.Text(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("sequence", name=op.f("pk_saved_views")),
        sa.UniqueConstraint("id", name=op.f("uq_saved_views_id")),
        sa.UniqueConstraint("campaign", "name", name=op.f("uq_saved_views_campaign_name")),
        sqlite_autoincrement=True,
    )
