"""How Ray is set wherever drivecal uses it. No module here imports Ray before these are in the environment: it reads them once."""

from __future__ import annotations

OBJECT_STORE_BYTES = 80 * 2**20
"""Shared memory of a node, Ray's least: batches and results travel with the calls, the object store stays empty."""
VERSION_LABEL = "drivecal-version"
"""Label of a node: the drivecal that is installed on it."""
PORT = 6379
"""Of the head, where nothing else is said."""

QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    # what the backend reports in one line, Ray would print in a paragraph
    "RAY_DEDUP_LOGS": "1",
    "RAY_DEDUP_LOGS_SKIP_REGEX": "A worker died or was killed|Raylet is terminated",
    # bookkeeping of every call for a dashboard that is not there: a fifth of a call's CPU time
    "RAY_task_events_report_interval_ms": "0",
    "RAY_enable_metrics_collection": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}
"""Environment of every process that uses Ray."""
ALERT = {
    # a node that ended is noticed within 3 to 4 s, one that is cut off, or vanished with its address, within 7; then it is shown within
    # 10 on a busy machine, too. Ray's own defaults take 14 to 65 s.
    "RAY_health_check_initial_delay_ms": "5000",
    "RAY_health_check_period_ms": "1000",
    "RAY_health_check_timeout_ms": "1000",
    "RAY_health_check_failure_threshold": "3",
    # a node whose head does not come back ends, and whoever restarts it joins the next one
    "RAY_gcs_rpc_server_reconnect_timeout_s": "30",
}
"""Environment of the nodes of a cluster, beside `QUIET`."""
