"""The first tables."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

# Types as they were at this revision: a revision never changes, so it shares nothing with tables.py.
IDENTITY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
NAME = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")
MOMENT = sa.DateTime(timezone=True)


def upgrade() -> None:
    """Creates all tables."""
    op.create_table(
        "influence_maps",
        sa.Column("sequence", IDENTITY, nullable=False),
        sa.Column("id", NAME, nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("source", sa.Text(), nullable=False),
        sa.Column("driving_function", sa.Text(), nullable=False),
        sa.Column("parameters", sa.JSON(), nullable=False),
        sa.Column("scenarios", sa.JSON(), nullable=False),
        sa.Column("basis", sa.JSON(), nullable=True),
        sa.Column("created_at", MOMENT, nullable=False),
        sa.PrimaryKeyConstraint("sequence", name=op.f("pk_influence_maps")),
        sa.UniqueConstraint("id", name=op.f("uq_influence_maps_id")),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "parameter_sets",
        sa.Column("id", IDENTITY, nullable=False),
        sa.Column("key", sa.LargeBinary(), nullable=False),
        sa.Column("parameter_values", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_parameter_sets")),
        sa.UniqueConstraint("key", name=op.f("uq_parameter_sets_key")),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "processes",
        sa.Column("name", NAME, nullable=False),
        sa.Column("pid", sa.Integer(), nullable=False),
        sa.Column("started_at", MOMENT, nullable=False),
        sa.Column("heartbeat_at", MOMENT, nullable=False),
        sa.Column("detail", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_processes")),
    )
    op.create_table(
        "reference_indexes",
        sa.Column("id", IDENTITY, nullable=False),
        sa.Column("influence_map_sequence", IDENTITY, nullable=False),
        sa.Column("setup_id", IDENTITY, nullable=False),
        sa.Column("evaluator", NAME, nullable=False),
        sa.Column("run_id", IDENTITY, nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_reference_indexes")),
        sa.UniqueConstraint(
            "influence_map_sequence",
            "setup_id",
            "evaluator",
            name=op.f("uq_reference_indexes_influence_map_sequence_setup_id_evaluator"),
        ),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "reference_keys",
        sa.Column("index_id", IDENTITY, autoincrement=False, nullable=False),
        sa.Column("key", sa.LargeBinary(), nullable=False),
        sa.Column("run_id", IDENTITY, autoincrement=False, nullable=False),
        sa.PrimaryKeyConstraint("index_id", "key", "run_id", name=op.f("pk_reference_keys")),
        sqlite_with_rowid=False,
    )
    op.create_table(
        "setups",
        sa.Column("id", IDENTITY, nullable=False),
        sa.Column("fingerprint", NAME, nullable=False),
        sa.Column("scenario", NAME, nullable=False),
        sa.Column("document", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_setups")),
        sa.UniqueConstraint("fingerprint", name=op.f("uq_setups_fingerprint")),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "campaigns",
        sa.Column("sequence", IDENTITY, nullable=False),
        sa.Column("id", NAME, nullable=False),
        sa.Column("kind", NAME, nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("state", NAME, nullable=False),
        sa.Column("requested_action", NAME, nullable=True),
        sa.Column("stage", sa.SmallInteger(), nullable=True),
        sa.Column("iteration", sa.Integer(), nullable=True),
        sa.Column("spec", sa.JSON(), nullable=False),
        sa.Column("resolution", sa.JSON(), nullable=True),
        sa.Column("narrowed", sa.JSON(), nullable=True),
        sa.Column("rerun_of", NAME, nullable=True),
        sa.Column("influence_map_id", NAME, nullable=True),
        sa.Column("idempotency_key", NAME, nullable=True),
        sa.Column("body_digest", NAME, nullable=True),
        sa.Column("watermark", IDENTITY, nullable=True),
        sa.Column("degraded", sa.Text(), nullable=True),
        sa.Column("error", sa.Text(), nullable=True),
        sa.Column("notes", sa.JSON(), nullable=False),
        sa.Column("cells", sa.JSON(), nullable=False),
        sa.Column("sensitivity_cells", sa.JSON(), nullable=False),
        sa.Column("progress", sa.JSON(), nullable=False),
        sa.Column("error_rate", sa.JSON(), nullable=False),
        sa.Column("best", sa.JSON(), nullable=True),
        sa.Column("baseline", sa.JSON(), nullable=True),
        sa.Column("simulating_seconds", sa.Float(), nullable=False),
        sa.Column("created_at", MOMENT, nullable=False),
        sa.Column("started_at", MOMENT, nullable=True),
        sa.Column("ended_at", MOMENT, nullable=True),
        sa.ForeignKeyConstraint(["influence_map_id"], ["influence_maps.id"], name=op.f("fk_campaigns_influence_map_id")),
        sa.ForeignKeyConstraint(["rerun_of"], ["campaigns.id"], name=op.f("fk_campaigns_rerun_of")),
        sa.PrimaryKeyConstraint("sequence", name=op.f("pk_campaigns")),
        sa.UniqueConstraint("id", name=op.f("uq_campaigns_id")),
        sa.UniqueConstraint("idempotency_key", name=op.f("uq_campaigns_idempotency_key")),
        sqlite_autoincrement=True,
    )
    op.create_index(
        "ix_campaigns_active",
        "campaigns",
        ["sequence"],
        unique=False,
        sqlite_where=sa.text("ended_at IS NULL"),
        postgresql_where=sa.text("ended_at IS NULL"),
    )
    op.create_table(
        "runs",
        sa.Column("id", IDENTITY, nullable=False),
        sa.Column("setup_id", IDENTITY, nullable=False),
        sa.Column("parameter_set_id", IDENTITY, nullable=False),
        sa.Column("metrics", sa.JSON(), nullable=False),
        sa.Column("failure", sa.Text(), nullable=True),
        sa.Column("milliseconds", sa.Float(), nullable=False),
        sa.Column("worker", sa.Text(), nullable=False),
        sa.Column("evaluation_id", IDENTITY, nullable=False),
        sa.Column("campaign_sequence", IDENTITY, nullable=False),
        sa.Column("stage", sa.SmallInteger(), nullable=False),
        sa.Column("iteration", sa.Integer(), nullable=False),
        sa.Column("individual", sa.Integer(), nullable=False),
        sa.Column("created_at", MOMENT, nullable=False),
        sa.ForeignKeyConstraint(["parameter_set_id"], ["parameter_sets.id"], name=op.f("fk_runs_parameter_set_id")),
        sa.ForeignKeyConstraint(["setup_id"], ["setups.id"], name=op.f("fk_runs_setup_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_runs")),
        sa.UniqueConstraint("setup_id", "parameter_set_id", name=op.f("uq_runs_setup_id_parameter_set_id")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_runs_setup_id_id"), "runs", ["setup_id", "id"], unique=False)
    op.create_table(
        "evaluations",
        sa.Column("id", IDENTITY, nullable=False),
        sa.Column("campaign_sequence", IDENTITY, nullable=False),
        sa.Column("stage", sa.SmallInteger(), nullable=False),
        sa.Column("iteration", sa.Integer(), nullable=False),
        sa.Column("individual", sa.Integer(), nullable=False),
        sa.Column("scenario", NAME, nullable=False),
        sa.Column("setup_id", IDENTITY, nullable=False),
        sa.Column("parameter_set_id", IDENTITY, nullable=False),
        sa.Column("reference_key", sa.LargeBinary(), nullable=True),
        sa.Column("plan", NAME, nullable=False),
        sa.Column("outcome", NAME, nullable=True),
        sa.Column("score", sa.Integer(), nullable=True),
        sa.Column("rating", sa.Float(), nullable=True),
        sa.Column("run_id", IDENTITY, nullable=True),
        sa.Column("reference", IDENTITY, nullable=True),
        sa.Column("audited", sa.Boolean(), nullable=False),
        sa.Column("agrees", sa.Boolean(), nullable=True),
        sa.Column("failure", sa.Text(), nullable=True),
        sa.Column("milliseconds", sa.Float(), nullable=True),
        sa.Column("worker", sa.Text(), nullable=True),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(["campaign_sequence"], ["campaigns.sequence"], name=op.f("fk_evaluations_campaign_sequence")),
        sa.ForeignKeyConstraint(["parameter_set_id"], ["parameter_sets.id"], name=op.f("fk_evaluations_parameter_set_id")),
        sa.ForeignKeyConstraint(["run_id"], ["runs.id"], name=op.f("fk_evaluations_run_id")),
        sa.ForeignKeyConstraint(["setup_id"], ["setups.id"], name=op.f("fk_evaluations_setup_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_evaluations")),
        sa.UniqueConstraint(
            "campaign_sequence",
            "stage",
            "iteration",
            "individual",
            "scenario",
            name=op.f("uq_evaluations_campaign_sequence_stage_iteration_individual_scenario"),
        ),
        sqlite_autoincrement=True,
    )
    op.create_index(
        op.f("ix_evaluations_campaign_sequence_scenario_parameter_set_id_plan"),
        "evaluations",
        ["campaign_sequence", "scenario", "parameter_set_id", "plan"],
        unique=False,
    )
    op.create_index(
        op.f("ix_evaluations_campaign_sequence_scenario_reference_key_plan"),
        "evaluations",
        ["campaign_sequence", "scenario", "reference_key", "plan"],
        unique=False,
    )
    op.create_index(
        "ix_evaluations_pending",
        "evaluations",
        ["campaign_sequence", "id"],
        unique=False,
        sqlite_where=sa.text("outcome IS NULL"),
        postgresql_where=sa.text("outcome IS NULL"),
    )
    op.create_table(
        "generations",
        sa.Column("campaign_sequence", IDENTITY, nullable=False),
        sa.Column("iteration", sa.Integer(), nullable=False),
        sa.Column("proposed", sa.Integer(), nullable=False),
        sa.Column("carried_over", sa.Integer(), nullable=False),
        sa.Column("requested", sa.Integer(), nullable=False),
        sa.Column("repeated", sa.Integer(), nullable=False),
        sa.Column("reused", sa.Integer(), nullable=False),
        sa.Column("certified", sa.Integer(), nullable=False),
        sa.Column("simulated", sa.Integer(), nullable=False),
        sa.Column("failed", sa.Integer(), nullable=False),
        sa.Column("audited", sa.Integer(), nullable=False),
        sa.Column("alternatives", sa.Integer(), nullable=False),
        sa.Column("best", sa.Float(), nullable=True),
        sa.Column("mean", sa.Float(), nullable=True),
        sa.Column("minimum", sa.Float(), nullable=True),
        sa.Column("population", sa.JSON(), nullable=False),
        sa.Column("changed", sa.JSON(), nullable=False),
        sa.Column("optimizer_state", sa.JSON(), nullable=True),
        sa.Column("objectives", sa.JSON(), nullable=True),
        sa.Column("finished", sa.Boolean(), nullable=False),
        sa.ForeignKeyConstraint(["campaign_sequence"], ["campaigns.sequence"], name=op.f("fk_generations_campaign_sequence")),
        sa.PrimaryKeyConstraint("campaign_sequence", "iteration", name=op.f("pk_generations")),
    )
    op.create_table(
        "ratings",
        sa.Column("run_id", IDENTITY, nullable=False),
        sa.Column("evaluator", NAME, nullable=False),
        sa.Column("score", sa.Integer(), nullable=False),
        sa.Column("rating", sa.Float(), nullable=False),
        sa.ForeignKeyConstraint(["run_id"], ["runs.id"], name=op.f("fk_ratings_run_id")),
        sa.PrimaryKeyConstraint("run_id", "evaluator", name=op.f("pk_ratings")),
        sqlite_with_rowid=False,
    )
