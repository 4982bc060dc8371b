"""Parts of tests: what the suite needs: the compose file on whatever Docker engine there is."""

from collections.abc import Iterator

import pytest
from tests.support.cluster_campaign import found_embedded
from tests.support.compose import Cluster, cluster_on_engine, engine
from tests.support.faults.findings import Found


@pytest.fixture(scope="session")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """The cluster of `docker-compose.yml` in a project of its own, built and started as the documentation says; nothing is left of it."""
    result = engine()
    if result is None:
        pytest.exit("there is no Docker engine with Compose 2: start one, or name one by DOCKER_HOST", returncode=2)
    print(f"\nDocker {result}", flush=True)
    with cluster_on_engine(tmp_path_factory.mktemp("cluster")) as running:
        yield running


@pytest.fixture(scope="session")
def embedded(tmp_path_factory: pytest.TempPathFactory) -> Found:
    """Returns what the campaign finds with `drivecal serve`, where nothing happens to it."""
    return found_embedded(tmp_path_factory.mktemp("embedded"))
