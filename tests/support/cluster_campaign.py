"""The campaign that clusters carry out while they are broken, and what it finds with `drivecal serve` where nothing happens."""

import os
from pathlib import Path
from typing import Any
from unittest.mock import patch

from tests.support.compose import Cluster
from tests.support.faults.coordinator import coordinator
from tests.support.faults.findings import Found, assert_equal, found
from tests.support.faults.lives import wait_until_ended
from tests.support.faults.workload import Accepted, post
from tests.support.server import serving

NAME = "in the cluster"
SCENARIOS = [f"S{number}" for number in range(1, 7)]
FINE: list[dict[str, Any]] = [{"name": f"P{number}", "lower": 0, "upper": 1, "step": 0.05} for number in range(1, 7)]
BOLD_MAP: dict[str, Any] = {
    "parameters": FINE,
    "catalogue": SCENARIOS,
    "scenarios": {name: {parameter: {"influential": False} for parameter in ("P5", "P6")} for name in SCENARIOS},
}
CAMPAIGN: dict[str, Any] = {
    "name": NAME,
    "catalogue": SCENARIOS,
    "parameters": FINE,
    "fixed": {f"P{number}": 0.5 for number in range(7, 12)},
    "optimizer": {"kind": "genetic", "population": 600, "iterations": 12, "seed": 11, "mutation": 1},
    "reduction": {"mode": "influence", "audit": 0.2, "max_error": 1},
}
"""Every way to an answer, and long enough (a minute on two idle cores) for what is done to the cluster meanwhile."""


def with_map(map_id: str) -> dict[str, Any]:
    """The campaign on the map that was posted."""
    return CAMPAIGN | {"sensitivity": {"map": map_id}}


def found_embedded(folder: Path) -> Found:
    """By `drivecal serve` on SQLite. It may choose its BLAS as containers do: another one differs in the last bits of the roads."""
    with patch.dict(os.environ):
        for name in [name for name in os.environ if name.startswith("OPENBLAS_")]:
            del os.environ[name]
        with coordinator(folder) as server:
            server.start_ready()
            identifier = post(server.url, "/api/v1/campaigns", with_map(post(server.url, "/api/v1/influence-maps", BOLD_MAP)))
            wait_until_ended(server, Accepted({NAME: identifier}), 1800.0)
            result = found(server, identifier)
            server.terminate()
    return result


class Running:
    """The campaign in a cluster."""

    def __init__(self, cluster: Cluster) -> None:
        """Submits it."""
        self.cluster = cluster
        map_id = cluster.http.post("/api/v1/influence-maps", json=BOLD_MAP).raise_for_status().json()["id"]
        self.id = cluster.http.post("/api/v1/campaigns", json=with_map(map_id)).raise_for_status().json()["id"]
        self.path = f"/api/v1/campaigns/{self.id}"

    def gets_on(self, more: int = 20) -> None:
        """Waits for further cells. AssertionError where it has ended by then: too early for what is to be done to it."""
        before: list[int] = []

        def further() -> bool:
            """The API may have no database at the moment."""
            document = self.cluster.get(self.path)
            assert document["state"] in {"queued", "running"}, f"it has {document['state']} before all was done to it"
            before.append(document["cells"]["simulated"])
            return before[-1] > before[0] + more

        self.cluster.until(further, "further cells")

    def wait(self) -> None:
        """Until it has ended."""
        self.cluster.until(
            lambda: self.cluster.get(self.path)["state"] not in {"queued", "running"}, "the end of the campaign", 1800.0
        )

    def assert_found(self, expected: Found, file: Path) -> None:
        """By a backup of the cluster's database, which is left in `file`."""
        self.cluster.compose("exec", "-T", "api", "rm", "-f", f"/backups/{file.name}")
        self.cluster.compose("exec", "-T", "api", "drivecal", "db", "backup", f"/backups/{file.name}")
        self.cluster.compose("cp", f"api:/backups/{file.name}", str(file))
        with serving(f"sqlite:///{file}") as copy:
            assert_equal(NAME, found(copy, self.id), expected)
