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
    rows = [
        re.split(r" \| ", row.strip("| \n")) for row in PAGE.read_text().splitlines() if row.startswith("| `") and " | " in row
    ]
    given = [
        (name.strip("`"), unit, meaning)
        for name, unit, meaning, *_ in rows
        if name.strip("`") not in {"python", "process", "fmu"}
    ]
    expected = [(name, entry.unit, entry.meaning) for table in TABLES for name, entry in table.items()]
    assert given == expected


def test_every_measure_has_a_source_that_the_page_shows() -> None:
    sources = {name: entry.source for name, entry in catalogue.MEASURES.items()}
    cited = re.compile(r"ISO \d+, \w+|.+\(\d{4}\)")
    assert all(source.startswith(catalogue.OWN_DEFINITION) or cited.match(source) for source in sources.values())
    rows = [re.split(r" \| ", row.strip("| ")) for row in PAGE.read_text().splitlines() if row.startswith("| `")]
    assert {name.strip("`"): rest[-1] for name, *rest in rows if name.strip("`") in sources} == sources


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
