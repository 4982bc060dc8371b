"""Damaged networks, route files and scenario files that pass the check of a push: a worker's session drives them, or names a cause.

6 drives in `make test-slow`, some 250 in `make test-faults`: each starts a simulator. `DRIVECAL_DRIVES=400` makes it 2,400.
"""

import os
import shutil
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.support import effort
from tests.support.motorways import CONTROLLERS, PARAMETERS, driven, motorway
from tests.support.mutations import mutated, nudged, outcome
from tests.support.networks import REAL, real
from tests.support.scenario_files import write_files

from drivecal.configuration.problems import read_bundle
from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import NoMeasuresError

ON_RAMP: dict[str, Any] = {
    "network": "merge.net.xml",
    "route": ["before", "beside", "after"],
    "duration": 4.0,
    "ego": {"lane": 0, "s": 60, "speed": 28},
    "routes": "merge.rou.xml",
}
ON_HIGHWAY: dict[str, Any] = {
    "network": "highway.net.xml",
    "route": list(REAL["highway"][1]),
    "duration": 4.0,
    "ego": {"s": 20, "speed": 24},
    "traffic": [{"s": 60, "speed": 22, "lane": 1, "model": "Krauss", "sigma": 0.3, "lane_change": "SL2015"}],
}
SUBJECTS: dict[str, tuple[str, dict[str, Any]]] = {
    "network": ("merge.net.xml", ON_RAMP),
    "real network": ("highway.net.xml", ON_HIGHWAY),
    "routes": ("merge.rou.xml", ON_RAMP),
    "cut_in": ("scenarios/cut_in.xosc", {"openscenario": "scenarios/cut_in.xosc", "duration": 4}),
    "walks_across": ("scenarios/walks_across.xosc", {"openscenario": "scenarios/walks_across.xosc", "duration": 4}),
    "cut_out": ("scenarios/cut_out.xosc", {"openscenario": "scenarios/cut_out.xosc", "duration": 4}),
}
"""The damaged file, and the scenario that reads it."""
DRIVES = {"few": 2, "many": int(os.environ.get("DRIVECAL_DRIVES") or effort.tries(10, 40))}
"""Drives of each subject."""


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle whose files are as they should be."""
    folder = motorway(tmp_path_factory.mktemp("hostile") / "sound")
    write_files(folder)
    (folder / "highway.net.xml").write_bytes(real("highway").read_bytes())
    return folder


def ending(folder: Path, data: Mapping[str, Any]) -> str:
    """How the drive of a bundle ends: `driven`, or the cause of a refusal. A hang fails, as does a refusal without a cause."""
    manifest = {
        "problem": "hostile",
        "parameters": {name: {"lower": 0, "upper": 40} for name in PARAMETERS},
        "simulator": {"kind": "highway", "controller": CONTROLLERS["python"]},
        "scenarios": {"drive": data},
        "measures": {"distance_m": "m"},
        "scores": {"far": {"formula": "distance_m", "direction": "maximise", "range": [0, 1000]}},
    }
    (folder / "problem.yaml").write_text(yaml.safe_dump(manifest))
    if not outcome(lambda: read_bundle(folder)):
        return "refused by the check"
    try:
        with driven(folder, data) as session:
            driven_once = session.evaluate(PARAMETERS)
            assert session.evaluate(PARAMETERS) == driven_once
    except (UnavailableError, NoMeasuresError) as error:
        cause = error
    else:
        return "driven"
    assert getattr(cause, "breakdown", None) is not Breakdown.HANG
    assert str(cause)
    return str(cause)


@pytest.mark.slow("network", "routes", "cut_in")
@pytest.mark.faults("many", "cut_out", "walks_across", "real network")
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("number", DRIVES)
@pytest.mark.parametrize("subject", SUBJECTS)
def test_damaged_files_are_driven_or_refused_by_name(sound: Path, tmp_path: Path, subject: str, number: str) -> None:
    file, data = SUBJECTS[subject]
    content, chance = (sound / file).read_bytes(), effort.chance(f"{subject} {number}")
    endings: Counter[str] = Counter()
    folder = tmp_path / "damaged"  # stays if the test fails
    while endings.total() - endings["refused by the check"] < DRIVES[number]:
        shutil.copytree(sound, folder)
        (folder / file).write_bytes(chance.choice((mutated, nudged))(content, chance))
        endings[ending(folder, data)] += 1
        shutil.rmtree(folder)
    assert endings["driven"], endings
