"""Problems of users on the cluster: pushed by an author, run from the workers' read-only images, and found to be what they are embedded."""

from pathlib import Path

import httpx
import pytest
from tests.support.compose import Cluster
from tests.support.serve import serving
from tests.support.user_problems import SPEC, problem, rows

from drivecal.client import Client

pytestmark = [pytest.mark.compose, pytest.mark.timeout(3600)]


@pytest.mark.parametrize("name", ["acc-process", "command-shell", "python-function", "fmu", "acc-highway"])
def test_a_cluster_finds_the_same(cluster: Cluster, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRIVECAL_HOME", str(tmp_path / "home"))
    folder = problem(name, tmp_path)
    with Client(cluster.url, cluster.token) as client:
        pushed = client.push_problem(folder)
        ended = client.wait(client.submit({**SPEC, "problem": name}).id)
        assert (ended.state, ended.error, ended.cells.failed) == ("succeeded", None, 0)
        assert ended.spec["problem"] == pushed.digest
        result = rows(client, ended.id)
    with serving(tmp_path, workers=2) as embedded, Client(embedded.url) as client:
        assert client.push_problem(folder).digest == pushed.digest
        expected = client.wait(client.submit({**SPEC, "problem": name}).id)
        assert rows(client, expected.id) == result
        assert expected.best == ended.best


def test_a_token_that_writes_does_not_push(cluster: Cluster) -> None:
    (writer,) = (row.split()[2] for row in (cluster.secrets / "tokens").read_text().splitlines() if row.split()[1] == "write")
    headers = {"Authorization": f"Bearer {writer}", "Content-Type": "application/zip"}
    assert cluster.http.post("/api/v1/problems", content=b"", headers=headers).status_code == httpx.codes.FORBIDDEN
