"""Settings of Ray for all processes of drivecal, and the release that nodes compare.

Set the environment before importing Ray, which reads it once.
"""

import re
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

OBJECT_STORE_BYTES = 80 * 2**20
"""Shared memory of a node, Ray's minimum: batches, archives and results travel with the calls."""
INLINE_BYTES = 256 * 2**20
"""Size up to which they do. Ray's own limit is 100 kB; beyond it lies in memory that every process of the user may map and change."""
VERSION_LABEL = "drivecal-version"
"""Label of a node with the release of its installed drivecal: version and digest of the sources."""
PORT = 6379
"""Default port of the head."""

QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    # The backend reports such deaths in one line; Ray would print a paragraph.
    "RAY_DEDUP_LOGS": "1",
    "RAY_DEDUP_LOGS_SKIP_REGEX": "A worker died or was killed|Raylet is terminated|has been marked dead",
    # Bookkeeping for the dashboard, which does not run, takes a fifth of a call's CPU time.
    "RAY_task_events_report_interval_ms": "0",
    "RAY_enable_metrics_collection": "0",
    # Statistics of its events, each minute and process, would fill /tmp in days. -1, which is to switch them off, writes without end.
    "RAY_event_stats_print_interval_ms": "86400000",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    # Ray gives its workers a niceness of 15: on a busy machine they would hardly run, and seem to hang.
    "RAY_worker_niceness": "0",
    "RAY_max_direct_call_object_size": str(INLINE_BYTES),
    "RAY_task_rpc_inlined_bytes_limit": str(INLINE_BYTES),
}
"""Environment of every process that uses Ray."""
ALERT = {
    # Ray detects a terminated node within 3 to 4 s, and an unreachable node or one whose address vanished within 7 s. drivecal then
    # shows it within 10 s, also on a busy machine. Ray's own defaults take 14 to 65 s.
    "RAY_health_check_initial_delay_ms": "5000",
    "RAY_health_check_period_ms": "1000",
    "RAY_health_check_timeout_ms": "1000",
    "RAY_health_check_failure_threshold": "3",
    # A node that is told to end does so: drivecal's workers never become idle, for which Ray would wait 30 s.
    "RAY_GRACEFUL_SHUTDOWN_DRAIN_TIMEOUT_S": "0",
    # A node exits if its head does not come back; its restart policy lets it join the next head.
    "RAY_gcs_rpc_server_reconnect_timeout_s": "30",
}
"""Environment of the nodes of a cluster, in addition to `QUIET`."""


PACKAGES = ("domain", "api", "runtime")
"""A package of each folder that holds sources. Any folder named `drivecal` where a process starts belongs to the namespace as well."""
DIGITS = 12
"""Hexadecimal digits of the sources' digest."""


def host_and_port(address: str) -> tuple[str, int]:
    """Returns where a head listens. Raises ValueError with what would be right."""
    host, _, port = address.rpartition(":")
    host = host[1:-1] if host.startswith("[") and host.endswith("]") else host
    is_host = re.fullmatch(r"[\w.:-]*[\w.-]|[\w:]*::", host) and max(map(len, host.split("."))) < 64
    if not is_host or not port.isdecimal() or not 0 < int(port) < 2**16:
        raise ValueError(f"{address!r} is not the address of a head; give HOST:PORT, e.g. ray-head:{PORT}")
    return host, int(port)


@cache
def release() -> str:
    """Returns the version and a digest of the installed sources, e.g. `0.1.0-5f0c1d2e3a4b`, read once per process.

    The version alone is the same for every commit between two releases. Not joined by `+`, which Ray does not allow in a label.
    """
    specs = (find_spec(f"drivecal.{name}") for name in PACKAGES)
    roots = {Path(spec.origin).parents[1] for spec in specs if spec is not None and spec.origin is not None}
    return f"{version('drivecal')}-{sources_digest(sorted(roots))}"


def sources_digest(roots: list[Path]) -> str:
    """Returns a digest of all `*.py` in the folders and their names; one folder or several with the same files have the same digest."""
    files = {path.relative_to(root).as_posix(): path for root in roots for path in root.rglob("*.py") if path.is_file()}
    digest = sha256()
    for name in sorted(files):
        content = files[name].read_bytes()
        digest.update(f"{name} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:DIGITS]
