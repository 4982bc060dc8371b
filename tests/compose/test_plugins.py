"""Plug-ins on the cluster: packages in a folder that API, dispatcher and nodes have on their path."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from tests.support.compose import Cluster
from tests.support.misbehaviour import FOLDER

from drivecal.client import Client

pytestmark = [pytest.mark.compose, pytest.mark.timeout(3600)]
SPEC = {
    "driving_function": "misbehaving",
    "catalogue": ["S1"],
    "parameters": "all",
    "fixed": {"behaviour": 0},
    "sensitivity": None,
    "optimizer": {"kind": "random", "population": 4, "iterations": 1, "seed": 1},
    "reduction": {"mode": "exact"},
}


def test_a_plug_in_reaches_the_cluster_in_a_folder(cluster: Cluster, tmp_path: Path) -> None:
    folder = tmp_path / "plugins"
    shutil.copytree(FOLDER, folder, ignore=shutil.ignore_patterns("__pycache__"))
    for path in (folder, *folder.rglob("*")):
        path.chmod(0o755 if path.is_dir() else 0o644)
    again = ("up", "-d", "--wait", "--no-deps", "--timeout", "10", "api", "dispatcher", "ray-worker")
    cluster.compose(*again, more=("deploy/docker-compose.plugins.yml",), environment={"DRIVECAL_PLUGINS": str(folder)})
    try:
        listed = cluster.get("/api/v1/parameters")
        assert "misbehaving" in {space["driving_function"] for space in listed["items"]}
        assert listed["broken"] == []
        with Client(cluster.url, cluster.token) as client:
            ended = client.wait(client.submit(SPEC).id)
        assert (ended.state, ended.error, ended.cells.failed) == ("succeeded", None, 0)
        assert ended.cells.simulated > 0
    finally:
        cluster.compose(*again)
