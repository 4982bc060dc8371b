"""What can happen to a campaign that is worth telling."""

from __future__ import annotations

from enum import StrEnum


class EventKind(StrEnum):
    """Names are stored and sent to clients: add some, never rename one.

    The first ten tell of the campaign's state, which their data holds as `state`.
    """

    QUEUED = "queued"
    RUNNING = "running"
    PAUSING = "pausing"
    """Asked to pause; what runs at workers is finished first."""
    PAUSED = "paused"
    RESUMING = "resuming"
    """Asked to go on."""
    RESUMED = "resumed"
    CANCELLING = "cancelling"
    """Asked to end; what runs at workers is finished first."""
    CANCELLED = "cancelled"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    """`error` says why."""

    DEGRADED = "degraded"
    """It goes on more slowly, or not at all, for now; `reason` says why."""
    RECOVERED = "recovered"
    """What `degraded` told is over."""
    STAGE = "stage"
    """A `stage` begins, with at most so many `cells`."""
    PHASE = "phase"
    """A `phase` of the sensitivity stage is finished: its `name`, and the stage's cells so far."""
    INFLUENCE_MAP = "influence_map"
    """The sensitivity stage stored its map: `id`, and the `influential` parameters by scenario."""
    GENERATION = "generation"
    """An `iteration` (from 0) of the calibration stage is finished: its cells by outcome, `best`, `mean` and `minimum` objective."""
    BEST = "best"
    """A parameter set is better than all before, or is the best one once those that seemed better were simulated: `objective`,
    `parameters`, `scores`, `alternatives` with the same objective, and the `iteration` that found it."""
    BASELINE = "baseline"
    """The result of the user's own parameter set is known: `objective`, `scores`."""
    REUSE_STOPPED = "reuse_stopped"
    """In a `scenario` too many audited cells were `wrong` of those `audited`; it is simulated from now on."""
    RUN = "run"
    """A `run` of a comparison has ended: its id, `name`, `state` and `best` objective; `ended` `of` so many."""
    NOTE = "note"
    """Something that a reader should know, as `text`."""
