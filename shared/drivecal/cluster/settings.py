"""Settings of Ray for all processes of drivecal. Set them in the environment before importing Ray, which reads them once."""

OBJECT_STORE_BYTES = 80 * 2**20
"""Shared memory of a node, Ray's minimum: batches and results travel with the calls; only recorded runs are in the object store."""
VERSION_LABEL = "drivecal-version"
"""Label of a node with the release of its installed drivecal: version and digest of the sources."""
PORT = 6379
"""Default port of the head."""

QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    # The backend reports these deaths in one line; Ray would print a paragraph.
    "RAY_DEDUP_LOGS": "1",
    "RAY_DEDUP_LOGS_SKIP_REGEX": "A worker died or was killed|Raylet is terminated",
    # Bookkeeping for the dashboard, which does not run, takes a fifth of a call's CPU time.
    "RAY_task_events_report_interval_ms": "0",
    "RAY_enable_metrics_collection": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}
"""Environment of every process that uses Ray."""
ALERT = {
    # Ray detects a terminated node within 3 to 4 s, and an unreachable node or one whose address vanished within 7 s. drivecal then
    # shows it within 10 s, also on a busy machine. Ray's own defaults take 14 to 65 s.
    "RAY_health_check_initial_delay_ms": "5000",
    "RAY_health_check_period_ms": "1000",
    "RAY_health_check_timeout_ms": "1000",
    "RAY_health_check_failure_threshold": "3",
    # A node exits if its head does not come back; its restart policy lets it join the next head.
    "RAY_gcs_rpc_server_reconnect_timeout_s": "30",
}
"""Environment of the nodes of a cluster, beside `QUIET`."""
