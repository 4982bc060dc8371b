"""Tests of what SUMO, or the check before it, refuses of a scenario of kind `highway`, and how the cause is told."""

from pathlib import Path

import pytest
from tests.support.motorways import CONTROLLERS, drive, driven, motorway

from drivecal.bundles.archives import content_digest, pack
from drivecal.bundles.highway import HighwaySimulator
from drivecal.contracts.work import Batch, Cell, SetupRequest
from drivecal.domain.errors import UnavailableError
from drivecal.plugins import simulators
from drivecal.plugins.simulators import UnsuitableError
from drivecal.runtime.bundles import BundleSessions
from drivecal.runtime.cache import BundleCache
from drivecal.runtime.worker import Worker


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return motorway(tmp_path_factory.mktemp("motorways") / "bundle")


def test_a_child_with_another_sumo_than_the_worker_s_names_both_versions(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """libsumo may be upgraded while a worker lives and starts further child processes."""
    installed = simulators.sumo()
    monkeypatch.setattr(simulators, "sumo", lambda: "libsumo 0.9")
    with pytest.raises(UnavailableError, match=r"libsumo 0\.9") as error, driven(folder, drive()):
        pass
    assert installed in str(error.value)
    assert not isinstance(error.value, UnsuitableError)


def test_a_controller_without_its_function_suits_no_machine(tmp_path: Path) -> None:
    bundle = motorway(tmp_path / "bundle", "def another(observation, parameters): return 0.0")
    with pytest.raises(UnsuitableError, match=r"acc\.py has no function"), driven(bundle, drive()):
        pass


@pytest.mark.slow
def test_a_worker_blames_a_problem_that_was_pushed_with_a_broken_network(tmp_path: Path) -> None:
    bundle = motorway(tmp_path / "bundle")
    (bundle / "road.net.xml").write_text("<net/>")
    (bundle / "problem.yaml").write_text("problem: p")
    archive = pack(bundle)
    section = HighwaySimulator.model_validate({"kind": "highway", "controller": CONTROLLERS["python"]}).model_dump(mode="json")
    setup = SetupRequest(
        content_digest(archive), "p", "drive", drive(), section, ("v0",), (), ("distance_m",), (), (), run_fingerprint="f"
    )
    works = Worker("w", bundles=BundleSessions(BundleCache(tmp_path / "cache")))
    works.store(setup.bundle, archive)
    refused = works.run(Batch(setup, (Cell(1, {"v0": 30.0}),)))
    assert (refused.unsuitable, refused.results) == (True, ())
    assert "road.net.xml" in (refused.refusal or "")
