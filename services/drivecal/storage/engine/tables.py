"""The tables, as the revisions in `migrations/versions` create them; a test compares both."""

from sqlalchemy import (
    Boolean,
    Column,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    Table,
    Text,
    UniqueConstraint,
    text,
)

from drivecal.contracts.campaign import Baseline, Best, CellCounts, Confirmation, ErrorRate, Progress, Released, SearchState
from drivecal.contracts.tables import Generation
from drivecal.storage.engine.types import Document, DocumentOf, Identity, Name, Score, StageNumber, UtcDateTime

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
    }
)


def _partial_index(name: str | None, *columns: str, where: str) -> Index:
    return Index(name, *columns, sqlite_where=text(where), postgresql_where=text(where))


influence_maps = Table(
    "influence_maps",
    metadata,
    Column("sequence", Identity, primary_key=True),
    Column("id", Name, nullable=False, unique=True),
    Column("name", Text, nullable=False),
    Column("source", Text, nullable=False),
    Column("driving_function", Text, nullable=False),
    Column("parameters", Document, nullable=False),
    Column("scenarios", Document, nullable=False),
    Column("basis", Document),
    Column("created_at", UtcDateTime, nullable=False),
    sqlite_autoincrement=True,
)

campaigns = Table(
    "campaigns",
    metadata,
    Column("sequence", Identity, primary_key=True),
    Column("id", Name, nullable=False, unique=True),
    Column("kind", Name, nullable=False),
    Column("name", Text, nullable=False),
    Column("state", Name, nullable=False),
    Column("requested_action", Name),
    Column("priority", Integer, nullable=False, server_default="0"),
    Column("revision", Integer, nullable=False, server_default="0"),
    Column("stage", StageNumber),
    Column("iteration", Integer),
    Column("spec", Document, nullable=False),
    Column("resolution", Document),
    Column("rerun_of", Name, ForeignKey("campaigns.id")),
    Column("influence_map_id", Name, ForeignKey("influence_maps.id")),
    # `of` of the specification's stages: the campaigns whose best sets and whose predictions it studies.
    Column("robustness_of", Name),
    Column("validation_of", Name),
    Column("idempotency_key", Name, unique=True),
    Column("body_digest", Name),
    Column("likeness", Name),  # campaigns that search the same have the same (`evaluations.released_before`)
    Column("watermark", Identity),
    Column("degraded", Text),
    Column("waiting", Text),  # why it, or some of its cells, wait, as the dispatcher says
    Column("owner", Name),  # name of the token that submitted it; null on a server without tokens
    Column("error", Text),
    Column("notes", DocumentOf(tuple[str, ...]), nullable=False),
    Column("progress", DocumentOf(Progress), nullable=False),
    Column("error_rate", DocumentOf(dict[str, ErrorRate]), nullable=False),
    Column("released", DocumentOf(dict[str, Released]), nullable=False, server_default="{}"),
    Column("best", DocumentOf(Best)),
    Column("search", DocumentOf(SearchState)),
    Column("confirmation", DocumentOf(Confirmation)),
    Column("baseline", DocumentOf(Baseline)),
    Column("simulating_seconds", Float, nullable=False),
    Column("created_at", UtcDateTime, nullable=False),
    Column("started_at", UtcDateTime),
    Column("ended_at", UtcDateTime),
    Column("tags", DocumentOf(tuple[str, ...]), nullable=False, server_default="[]"),
    # A deleted campaign's row stays with the cells that made runs of the reference table (`storage.maintenance.deletion`).
    Column("deleted_at", UtcDateTime),
    Column("finish_at", UtcDateTime),  # when an outside optimizer said that it proposes no more sets
    *(
        _partial_index(None, name, where=f"{name} IS NOT NULL")
        for name in ("rerun_of", "influence_map_id", "robustness_of", "validation_of", "likeness")
    ),
    # Lists show these: without it, a page reads past every single evaluation.
    _partial_index("ix_campaigns_listed", "sequence", where="kind <> 'evaluation'"),
    # The dispatcher asks for these all the time: some campaigns among all that ever were.
    _partial_index("ix_campaigns_active", "sequence", where="ended_at IS NULL"),
    sqlite_autoincrement=True,
)

campaign_stages = Table(
    "campaign_stages",
    metadata,
    Column("campaign_sequence", Identity, ForeignKey("campaigns.sequence"), primary_key=True, autoincrement=False),
    Column("stage", StageNumber, primary_key=True, autoincrement=False),
    Column("cells", DocumentOf(CellCounts), nullable=False),
)

generations = Table(
    "generations",
    metadata,
    Column("campaign_sequence", Identity, ForeignKey("campaigns.sequence"), primary_key=True),
    Column("iteration", Integer, primary_key=True),
    Column("figures", DocumentOf(Generation), nullable=False),
    Column("population", Document, nullable=False),
    Column("changed", Document, nullable=False),
    Column("optimizer_state", Document),
    Column("objectives", Document),
    Column("finished", Boolean, nullable=False),
)

setups = Table(
    "setups",
    metadata,
    Column("id", Identity, primary_key=True),
    Column("fingerprint", Name, nullable=False, unique=True),
    Column("scenario", Name, nullable=False),
    Column("document", Document, nullable=False),  # with the seed, so that references are kept and found by seed
    sqlite_autoincrement=True,
)

parameter_sets = Table(
    "parameter_sets",
    metadata,
    Column("id", Identity, primary_key=True),
    Column("key", LargeBinary, nullable=False, unique=True),
    Column("parameter_values", Text, nullable=False),
    sqlite_autoincrement=True,
)

metric_names = Table(  # names of the metrics of runs, each list once (`storage.references.metrics`)
    "metric_names", metadata, Column("digest", Name, primary_key=True), Column("names", Document, nullable=False)
)

runs = Table(  # the reference table of the paper: simulated results, each (setup, parameter set) once
    "runs",
    metadata,
    Column("id", Identity, primary_key=True),
    Column("setup_id", Identity, ForeignKey("setups.id"), nullable=False),
    Column("parameter_set_id", Identity, ForeignKey("parameter_sets.id"), nullable=False),
    Column("metrics", Document, nullable=False),
    Column("failure", Text),
    Column("milliseconds", Float, nullable=False),
    Column("worker", Text, nullable=False),
    # The evaluation that simulated it, and its place in the order of references; no foreign keys, for evaluations point here.
    Column("evaluation_id", Identity, nullable=False),
    Column("campaign_sequence", Identity, nullable=False),
    Column("stage", StageNumber, nullable=False),
    Column("iteration", Integer, nullable=False),
    Column("individual", Integer, nullable=False),
    Column("created_at", UtcDateTime, nullable=False),
    Column("wall_milliseconds", Float),
    UniqueConstraint("setup_id", "parameter_set_id"),
    Index(None, "setup_id", "id"),
    Index("ix_runs_origin", "setup_id", "campaign_sequence", "stage", "iteration", "individual", "id"),
    sqlite_autoincrement=True,
)

ratings = Table(
    "ratings",
    metadata,
    Column("run_id", Identity, ForeignKey("runs.id"), primary_key=True),
    Column("evaluator", Name, primary_key=True),
    Column("score", Score, nullable=False),
    Column("rating", Float, nullable=False),
    # From which watermark on it is seen, where it is younger than its run; 0 if it is as old. Of the same numbers as the ids of runs.
    Column("since", Identity, nullable=False, server_default="0"),
    _partial_index(None, "since", where="since > 0"),
    sqlite_with_rowid=False,
)

# Derived from runs and ratings, and rebuilt from them at any time: no foreign keys, which would slow bulk inserts down. A look-up
# finds in it all that it gives (`storage.references.reference_keys`).
reference_keys = Table(
    "reference_keys",
    metadata,
    Column("index_id", Identity, primary_key=True, autoincrement=False),
    Column("key", LargeBinary, primary_key=True),
    Column("run_id", Identity, primary_key=True, autoincrement=False),
    Column("evaluation_id", Identity, nullable=False),
    Column("score", Score, nullable=False),
    Column("rating", Float, nullable=False),
    Column("failure", Text),
    Column("since", Identity, nullable=False, server_default="0"),
    sqlite_with_rowid=False,
)

reference_indexes = Table(  # the last run with a key, for each setup, map and evaluator that rated its runs
    "reference_indexes",
    metadata,
    Column("id", Identity, primary_key=True),
    Column("influence_map_sequence", Identity, nullable=False),
    Column("setup_id", Identity, nullable=False),
    Column("evaluator", Name, nullable=False),
    Column("run_id", Identity, nullable=False),
    UniqueConstraint("influence_map_sequence", "setup_id", "evaluator"),
    sqlite_autoincrement=True,
)

lots = Table(  # answers of a batch in a scenario that are inspected together; size 0: no prediction was accepted
    "lots",
    metadata,
    Column("id", Identity, primary_key=True),
    Column("campaign_sequence", Identity, ForeignKey("campaigns.sequence"), nullable=False),
    Column("iteration", Integer, nullable=False),
    Column("individual", Integer, nullable=False),  # the first of the batch
    Column("scenario", Name, nullable=False),
    Column("size", Integer, nullable=False),
    Column("sample", Integer, nullable=False),
    Column("acceptance", Integer, nullable=False),
    Column("tolerance", Float, nullable=False),
    Column("aoql", Float, nullable=False),
    Column("known", Integer, nullable=False),
    Column("seconds", Float, nullable=False),
    Column("verdict", Name),
    Column("errors", Integer),
    Column("kind", Name, nullable=False, server_default="predicted"),  # the outcome that its released cells have
    UniqueConstraint("campaign_sequence", "iteration", "individual", "scenario", "kind"),
    sqlite_autoincrement=True,
)

evaluations = Table(
    "evaluations",
    metadata,
    Column("id", Identity, primary_key=True),
    Column("campaign_sequence", Identity, ForeignKey("campaigns.sequence"), nullable=False),
    Column("stage", StageNumber, nullable=False),
    Column("iteration", Integer, nullable=False),
    Column("individual", Integer, nullable=False),
    Column("scenario", Name, nullable=False),
    Column("setup_id", Identity, ForeignKey("setups.id"), nullable=False),
    Column("parameter_set_id", Identity, ForeignKey("parameter_sets.id"), nullable=False),
    Column("reference_key", LargeBinary),
    Column("plan", Name, nullable=False),
    Column("outcome", Name),
    Column("score", Score),
    Column("rating", Float),
    Column("run_id", Identity, ForeignKey("runs.id")),
    Column("reference", Identity),
    Column("purpose", Name, nullable=False),  # what it was asked for (`domain.evaluations.Purpose`)
    Column("agrees", Boolean),
    Column("failure", Text),
    Column("milliseconds", Float),
    Column("worker", Text),
    Column("attempts", Integer, nullable=False),
    Column("runs", Integer, nullable=False),  # starts of the simulator, as in `CellCounts`
    Column("detail", Text),
    Column("metrics", Document),  # of its own run, if the stored run of the same set differs or has fewer
    # Set for cells that the predictor predicted. `lot` is set if it was trusted, or if references are to answer the cell.
    Column("lot", Identity),
    Column("confidence", Float),
    Column("predicted_score", Score),
    Column("predicted_rating", Float),
    # Set for cells that an outside optimizer requested: the place of the answer by arrival in its campaign.
    Column("answered", Integer),
    Column("seed", Integer, nullable=False, server_default="0"),  # 0: the simulator does not depend on one
    UniqueConstraint("campaign_sequence", "stage", "iteration", "individual", "scenario", "seed"),
    _partial_index("ix_evaluations_answered", "campaign_sequence", "answered", where="answered IS NOT NULL"),
    # The plan is in the two look-up indexes, or a class that answered thousands of cells would be read in full to find its donor.
    Index(None, "campaign_sequence", "scenario", "reference_key", "plan"),
    Index(None, "campaign_sequence", "scenario", "parameter_set_id", "plan"),
    # The cells that a run answered, when it is removed; without it, each removed run reads all cells.
    _partial_index(None, "run_id", where="run_id IS NOT NULL"),
    _partial_index("ix_evaluations_pending", "campaign_sequence", "id", where="outcome IS NULL"),
    sqlite_autoincrement=True,
)

outside_sets = Table(  # parameter sets that outside optimizers propose to campaigns, until and after a round asks for them
    "outside_sets",
    metadata,
    Column("campaign_sequence", Identity, ForeignKey("campaigns.sequence"), primary_key=True, autoincrement=False),
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("key", Name, nullable=False),
    Column("indices", Document, nullable=False),  # of the grid, by searched parameter
    Column("scenarios", Document),  # null: all of the campaign
    Column("replicates", Integer, nullable=False),
    Column("cancelled", Boolean, nullable=False),
    # Its place among the evaluations; null before.
    Column("iteration", Integer),
    Column("individual", Integer),
    UniqueConstraint("campaign_sequence", "key"),
    _partial_index("ix_outside_sets_waiting", "campaign_sequence", "number", where="iteration IS NULL AND NOT cancelled"),
)

imported_results = Table(  # of vehicles, test benches and other tools; by the problem's name, whatever is pushed under it
    "imported_results",
    metadata,
    Column("id", Identity, primary_key=True),
    Column("problem", Name, nullable=False),
    Column("source", Text, nullable=False),
    Column("date", Name, nullable=False),
    Column("owner", Name),
    Column("parameter_set_id", Identity, ForeignKey("parameter_sets.id"), nullable=False),
    Column("form", Name, nullable=False),
    Column("scenario", Name, nullable=False),
    Column("scores", Document, nullable=False),
    Column("measures", Document, nullable=False),
    Column("created_at", UtcDateTime, nullable=False),
    UniqueConstraint("problem", "source", "date", "parameter_set_id", "scenario"),
    sqlite_autoincrement=True,
)

processes = Table(
    "processes",
    metadata,
    Column("name", Name, primary_key=True),
    Column("pid", Integer, nullable=False),
    Column("started_at", UtcDateTime, nullable=False),
    Column("heartbeat_at", UtcDateTime, nullable=False),
    Column("detail", Document, nullable=False),
    Column("term", Integer, nullable=False, server_default="0"),
)

leases = Table(  # for cells at workers, and cells that broke down there before; an answered cell has no lease
    "leases",
    metadata,
    Column("evaluation_id", Identity, ForeignKey("evaluations.id"), primary_key=True, autoincrement=False),
    Column("number", Integer, nullable=False),
    Column("attempts", Integer, nullable=False),
    # Starts of the simulator for this cell, none is missing: broken down, under the current lease, lost.
    Column("starts", Integer, nullable=False),
    Column("running", Integer, nullable=False),
    Column("lost", Integer, nullable=False),
    Column("term", Integer, nullable=False),
    Column("at_worker", Boolean, nullable=False),  # false: given back
)

studies = Table(  # results of the stages after the calibration
    "studies",
    metadata,
    Column("campaign_sequence", Identity, ForeignKey("campaigns.sequence"), primary_key=True, autoincrement=False),
    Column("stage", StageNumber, primary_key=True, autoincrement=False),
    Column("document", Document, nullable=False),
)

traces = Table(  # time series of single evaluations, asked for one by one and kept for a while (`storage.traces`)
    "traces",
    metadata,
    Column("evaluation_id", Identity, ForeignKey("evaluations.id"), primary_key=True, autoincrement=False),
    # The single evaluation that simulates it once more.
    Column("campaign_sequence", Identity, ForeignKey("campaigns.sequence"), nullable=False),
    Column("content", LargeBinary),
    Column("created_at", UtcDateTime, nullable=False),
)

bundles = Table(  # problems that users pushed, each content once; a name means the last push (`storage.bundles`)
    "bundles",
    metadata,
    Column("digest", Name, primary_key=True),
    Column("name", Name, nullable=False),
    Column("manifest", Document, nullable=False),
    Column("size", Integer, nullable=False),
    Column("pushed", Identity, nullable=False),
    Column("created_at", UtcDateTime, nullable=False),
    # Last: SQLite reads a row from its start, and lists need all columns but this one.
    Column("archive", LargeBinary, nullable=False),
    Index(None, "name", "pushed", unique=True),
)

events = Table(
    "events",
    metadata,
    Column("id", Identity, primary_key=True),
    Column("campaign_sequence", Identity, ForeignKey("campaigns.sequence"), nullable=False),
    Column("kind", Name, nullable=False),
    Column("data", Document, nullable=False),
    Column("created_at", UtcDateTime, nullable=False),
    Column("unposted", Boolean),  # true until a webhook has posted it; null if none is to
    Index(None, "campaign_sequence", "id"),
    Index(None, "created_at"),
    _partial_index("ix_events_unposted", "id", where="unposted IS NOT NULL"),
    sqlite_autoincrement=True,
)
