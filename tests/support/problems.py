"""A problem that shares nothing with the motorway: less is better, parameters of every kind, failures, time series."""

import gzip
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from tests.support.zips import zipped

from drivecal.api import submission
from drivecal.api.dependencies import Limits
from drivecal.bundles.archives import content_digest, files_of, pack
from drivecal.bundles.checks import checked
from drivecal.bundles.highway_catalogue import MEASURES as CATALOGUE
from drivecal.configuration.problems import read_archived
from drivecal.configuration.settings import load_settings
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import Cell, CellResult
from drivecal.storage import admission, bundles
from drivecal.storage.bundles import StoredBundle
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

LIMITS = Limits.of(load_settings())
MANIFEST: dict[str, Any] = {
    "problem": "heater",
    "description": "A room that is heated",
    "parameters": {
        "gain": {"lower": 0, "upper": 2, "unit": "W/K", "description": "Power for each degree below the set point"},
        "stage": {"lower": 0.5, "upper": 2.5, "step": 0.5, "unit": "kW"},
        "rooms": {"lower": 1, "upper": 6, "integer": True},
        "mode": {"choices": ["eco", "normal", "boost"], "description": "Programme of the pump"},
    },
    "constraints": ["gain <= 2*stage"],
    "baseline": {"gain": 0.5, "stage": 1, "rooms": 3, "mode": "normal"},
    "simulator": {"kind": "command", "command": ["sh", "./run.sh", "{parameters}", "{scenario}", "{results}"]},
    "scenarios": {"winter": {"outside": -10}, "spring": {"outside": 12}},
    "measures": {"energy_kwh": "kWh", "discomfort": "K"},
    "failures": ["frozen"],
    "series": {"time": "s", "room": "°C", "wanted": "°C", "power": "kW"},
    "scores": {
        "cost": {
            "formula": "10*energy_kwh + 5*discomfort",
            "direction": "minimise",
            "range": [0, 100],
            "tolerance": 2,
            "failed": 120,
            "unit": "EUR",
        },
        "ease": {"formula": "10 - discomfort", "direction": "maximise", "range": [0, 10]},
    },
}
RANDOM: dict[str, Any] = {
    "problem": "mine",
    "sensitivity": None,
    "optimizer": {"kind": "random", "population": 40, "iterations": 2, "seed": 1},
    "reduction": {"mode": "exact"},
}
"""A campaign on a problem of this name."""
SERIES = {"time": [0.0, 1.0, 2.0], "room": [15.0, 18.0, 20.5], "wanted": [21.0, 21.0, 21.0], "power": [2.0, 1.5, 0.5]}

ROADS: dict[str, Any] = {
    "problem": "roads",
    "parameters": {"v": {"lower": 20, "upper": 30}},
    "simulator": {"kind": "highway", "controller": {"kind": "python", "file": "acc.py", "output": ["acceleration"]}},
    "scenarios": {"merge": {"network": "road.net.xml", "route": ["a"], "duration": 2, "ego": {"s": 20, "speed": 30}}},
    "measures": {"distance_m": "m"},
    "scores": {"far": {"formula": "distance_m", "direction": "maximise", "range": [0, 100]}},
}
"""A problem on a road network that declares no time series."""
STRIP = {"right": [[0.0, -2.0], [90.0, -2.0], [180.0, -2.0]], "left": [[0.0, 2.0], [90.0, 2.0], [180.0, 2.0]]}
PLACES = {"x_m": [20.0, 50.0, 80.0], "y_m": [0.0, 0.0, 0.0], "heading_rad": [0.0, 0.0, 0.0]}
REPLAY: dict[str, Any] = {
    "time_s": [0.0, 1.0, 2.0],
    "line": [[0.0, 0.0, 0.0, 0.0], [180.0, 180.0, 0.0, 0.0]],
    "route": {"lanes": [STRIP], "edges": [STRIP["right"], STRIP["left"]], "markings": []},
    "ego": {
        "length_m": 4.7,
        "width_m": 1.9,
        **PLACES,
        "speed_mps": [30.0] * 3,
        "position_m": PLACES["x_m"],
        "offset_m": [0.0] * 3,
    },
    "others": [{"id": "leader", "first": 0, "length_m": 5.0, "width_m": 1.8, **PLACES, "x_m": [60.0, 90.0, 120.0]}],
    "plans": [],
}


def scored(name: str, parameters: Mapping[str, Any], formula: str = "y", **changes: Any) -> dict[str, Any]:
    """The manifest of a problem with one measure and one score, a cost."""
    return {
        "problem": name,
        "parameters": parameters,
        "simulator": {"kind": "process", "command": ["mysim"], "deterministic": True},
        "scenarios": {"city": {}, "road": {}},
        "measures": {"y": "1"},
        "scores": {"cost": {"formula": formula, "direction": "minimise", "range": [0, 10]}},
    } | changes


def push(database: Database, folder: Path, **changes: Any) -> StoredBundle:
    """Stores the problem as a push would, with changes of its manifest."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "problem.yaml").write_text(yaml.safe_dump(MANIFEST | changes, sort_keys=False))
    (folder / "run.sh").write_text("exit 1\n")
    archive = pack(folder)
    files = files_of(archive, 2**20)
    manifest, _ = read_archived(files)
    digest = content_digest(archive)
    with database.transaction() as connection:
        admission.admit_problem(connection, digest, 1000)
        document = manifest.model_dump(mode="json")
        return bundles.add(connection, digest=digest, name=manifest.problem, manifest=document, archive=archive)[0]


def store(database: Database, document: Mapping[str, Any], files: Mapping[str, str] | None = None) -> str:
    """Stores a problem of this manifest and these texts of files; returns its digest."""
    archived = zipped(("problem.yaml", yaml.safe_dump(dict(document), sort_keys=False)), *(files or {}).items())
    manifest = checked(document).model_dump(mode="json")
    digest = content_digest(archived)
    with database.transaction() as connection:
        bundles.add(connection, digest=digest, name=document["problem"], manifest=manifest, archive=archived)
    return digest


def submit_checked(database: Database, specification: Mapping[str, Any]) -> StoredCampaign:
    """Submits a campaign as the API does."""
    return submission.submit(database, LIMITS, CampaignSpecification.model_validate(specification), None)


def heated(scenario: str, cell: Cell) -> CellResult:
    """Measures of a cell; little power in winter freezes."""
    p = cell.parameters
    power = p["gain"] * p["stage"] * {"eco": 0.6, "normal": 1, "boost": 1.3}[p["mode"]]
    cold = 3 if scenario == "winter" else 1
    measures = {"energy_kwh": power + 0.2 * p["rooms"], "discomfort": abs(cold - power)}
    failure = "frozen" if scenario == "winter" and power < 0.4 else None
    trace = {"measures": measures, "failure": failure, "series": SERIES}
    content = gzip.compress(json.dumps(trace).encode(), mtime=0) if cell.trace else None
    return CellResult(cell.id, None, None, measures, failure, 7.0, trace=content)


def replayed(scenario: str, cell: Cell) -> CellResult:
    """Measures of a drive on a road network, and its replay."""
    del scenario
    measures = dict.fromkeys(CATALOGUE, 1.0) | {"distance_m": cell.parameters["v"]}
    trace = {"measures": measures, "failure": None, "series": {}, "replay": REPLAY}
    content = gzip.compress(json.dumps(trace).encode(), mtime=0) if cell.trace else None
    return CellResult(cell.id, None, None, measures, None, 7.0, trace=content)
