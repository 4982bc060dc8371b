"""Lots of references beside lots of predictions."""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None

NAME = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")
PLACE = ("campaign_sequence", "iteration", "individual", "scenario")


def upgrade() -> None:
    """Stored lots are of predictions. The table is small, so that SQLite may write it anew."""
    with op.batch_alter_table("lots", table_kwargs={"sqlite_autoincrement": True}) as lots:
        lots.add_column(sa.Column("kind", NAME, nullable=False, server_default="predicted"))
        lots.drop_constraint(f"uq_lots_{'_'.join(PLACE)}", type_="unique")
        lots.create_unique_constraint(f"uq_lots_{'_'.join(PLACE)}_kind", [*PLACE, "kind"])
