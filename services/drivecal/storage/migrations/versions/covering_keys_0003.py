"""Reference keys hold the columns of their donors, so that a look-up reads no other table."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

IDENTITY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Copies the keys into a wider table; about ten seconds for a million of them."""
    op.rename_table("reference_keys", "narrow_keys")
    if op.get_bind().dialect.name == "postgresql":  # names of indexes are those of tables there
        op.drop_constraint("pk_reference_keys", "narrow_keys")
    op.create_table(
        "reference_keys",
        sa.Column("index_id", IDENTITY, autoincrement=False, nullable=False),
        sa.Column("key", sa.LargeBinary(), nullable=False),
        sa.Column("run_id", IDENTITY, autoincrement=False, nullable=False),
        sa.Column("evaluation_id", IDENTITY, nullable=False),
        sa.Column("score", sa.Integer(), nullable=False),
        sa.Column("rating", sa.Float(), nullable=False),
        sa.Column("failure", sa.Text(), nullable=True),
        sa.PrimaryKeyConstraint("index_id", "key", "run_id", name=op.f("pk_reference_keys")),
        sqlite_with_rowid=False,
    )
    op.execute(
        "INSERT INTO reference_keys (index_id, key, run_id, evaluation_id, score, rating, failure)"
        " SELECT narrow_keys.index_id, narrow_keys.key, runs.id, runs.evaluation_id, ratings.score, ratings.rating, runs.failure"
        " FROM narrow_keys"
        " JOIN reference_indexes ON reference_indexes.id = narrow_keys.index_id"
        " JOIN runs ON runs.id = narrow_keys.run_id"
        " JOIN ratings ON ratings.run_id = runs.id AND ratings.evaluator = reference_indexes.evaluator"
        " ORDER BY narrow_keys.index_id, narrow_keys.key, narrow_keys.run_id"
    )
    op.drop_table("narrow_keys")
