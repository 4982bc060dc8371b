"""Kinds of events of a campaign."""

from __future__ import annotations

from enum import StrEnum


class EventKind(StrEnum):
    """Kind of an event. Names are stored and sent to clients: add names, never rename them.

    The first ten kinds report the campaign's state, which their data holds as `state`.
    """

    QUEUED = "queued"
    RUNNING = "running"
    PAUSING = "pausing"
    """Pause requested; workers finish their running cells first."""
    PAUSED = "paused"
    RESUMING = "resuming"
    """Resumption requested."""
    RESUMED = "resumed"
    CANCELLING = "cancelling"
    """Cancellation requested; workers finish their running cells first."""
    CANCELLED = "cancelled"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    """`error`: the reason."""

    DEGRADED = "degraded"
    """The campaign is slowed down or stopped for now; `reason`: the cause."""
    RECOVERED = "recovered"
    """The cause of the last `degraded` event is gone."""
    STAGE = "stage"
    """A `stage` begins, with at most `cells` cells."""
    PHASE = "phase"
    """A `phase` of the sensitivity stage is finished: its `name` and the stage's cells so far."""
    INFLUENCE_MAP = "influence_map"
    """The sensitivity stage stored its map: `id`, and the `influential` parameters by scenario."""
    GENERATION = "generation"
    """An `iteration` (from 0) of the calibration stage is finished: its cells by outcome, `best`, `mean` and `minimum` objective."""
    BEST = "best"
    """A new best parameter set, either better than all before or best after seemingly better sets were simulated.

    Data: `objective`, `parameters`, `scores`, `alternatives` with the same objective, and the `iteration` of origin.
    """
    BASELINE = "baseline"
    """The result of the user's own parameter set is known: `objective`, `scores`."""
    REUSE_STOPPED = "reuse_stopped"
    """Too many `audited` cells of a `scenario` were `wrong`; from now on all its cells are simulated."""
    RUN = "run"
    """A `run` of a comparison has ended: its id, `name`, `state` and `best` objective; `ended` runs `of` the total."""
    NOTE = "note"
    """A remark for the reader, as `text`."""
