"""Which campaigns' sets and predictions a campaign studies, and the uses of a map, where an index finds them."""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None

NAME = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")


def upgrade() -> None:
    """Only adds; reads the specification of every campaign."""
    campaigns = sa.table(
        "campaigns", sa.column("spec", sa.JSON()), *(sa.column(name) for name in ("robustness_of", "validation_of"))
    )
    for name in ("robustness_of", "validation_of"):
        op.add_column("campaigns", sa.Column(name, NAME))
    op.execute(
        sa.update(campaigns).values(
            robustness_of=campaigns.c.spec["robustness", "of"].as_string(),
            validation_of=campaigns.c.spec["validation", "of"].as_string(),
        )
    )
    for name in ("robustness_of", "validation_of", "influence_map_id"):
        filled = sa.text(f"{name} IS NOT NULL")
        op.create_index(op.f(f"ix_campaigns_{name}"), "campaigns", [name], sqlite_where=filled, postgresql_where=filled)
