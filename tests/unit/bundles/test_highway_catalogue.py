"""The documentation of the simulator `highway` lists exactly what it observes, takes, measures and records."""

import re
from pathlib import Path
from typing import Any

import yaml

from drivecal.bundles import highway_catalogue as catalogue
from drivecal.bundles.highway import FmuController, HighwayScenario, HighwaySimulator
from drivecal.bundles.highway_checks import scenarios_problems, simulator_problems

PAGE = Path(catalogue.__file__).with_name("highway.md")
TABLES = (catalogue.COMMANDS, catalogue.SIGNALS, catalogue.MEASURES, catalogue.SERIES)


def test_every_table_is_that_of_the_catalogue() -> None:
    rows = [row.strip("| ").split(" | ") for row in PAGE.read_text().splitlines() if row.startswith("| `") and " | " in row]
    given = [(row[0].strip("`"), *row[1:]) for row in rows if row[0].strip("`") not in {"python", "process", "fmu"}]
    assert [row[:2] for row in given] == [entry for table in TABLES for entry in table.items()]
    sources = [row[3] for row in given if row[0] in catalogue.MEASURES]
    assert all(re.match(r"own definition|ISO \d+, \w+|.+\(\d{4}\)", source) for source in sources)


def test_the_examples_of_the_page_are_valid() -> None:
    blocks: list[Any] = [yaml.safe_load(text) for text in re.findall(r"```yaml\n(.*?)```", PAGE.read_text(), re.DOTALL)]
    simulator = HighwaySimulator.model_validate(blocks[0]["simulator"])
    assert list(simulator_problems(simulator)) == []
    fmu = HighwaySimulator.model_validate(blocks[1]["simulator"])
    assert isinstance(fmu.controller, FmuController)
    assert list(simulator_problems(fmu)) == []
    for block in blocks[2:4]:
        assert list(scenarios_problems(simulator.step, block["scenarios"])) == []
    assert HighwayScenario.model_validate(blocks[2]["scenarios"]["merge"]).traffic
