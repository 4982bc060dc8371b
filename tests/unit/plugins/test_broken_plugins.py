"""Packages of users: what is found, and that a broken one, or one whose name is taken, costs only what is asked of it by name."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

GOOD = """
from drivecal.plugins import registry
class Catalogue:
    name = {name!r}
    scenarios = {scenarios}
PLUGIN = Catalogue()
"""
THEIRS_HAS_S1 = GOOD.format(name="theirs", scenarios="dict(list(registry.catalogue('highway').scenarios.items())[:1])")
EMPTY = GOOD.format(name="theirs", scenarios="{}")

LISTS = """
import json
from drivecal.api.routes import inventory
from drivecal.plugins import registry
from drivecal.domain.errors import InvalidInputError
scenarios, spaces = inventory.scenarios(), inventory.parameters()
def refusal(find):
    try:
        find()
    except InvalidInputError as error:
        return [problem.field for problem in error.problems], error.problems[0].remedy
print(json.dumps({
    "catalogues": sorted({scenario.catalogue for scenario in scenarios.items}),
    "functions": sorted({space.driving_function for space in spaces.items}),
    "broken": [[plugin.group, plugin.name, plugin.package, plugin.error] for plugin in [*scenarios.broken, *spaces.broken]],
    "all": [str(plugin) for plugin in registry.broken()],
    "one": registry.catalogue("highway").name,
    "named": refusal(lambda: registry.catalogue("theirs")),
}))
"""
BY_ID = """
import json
from drivecal.domain.errors import Diagnostics
from drivecal.campaigns.resolve.resolvers import find_scenarios
diagnostics = Diagnostics()
find_scenarios(["S2", "S1"], ["S2", "S1"], diagnostics)
print(json.dumps([[problem.field, problem.message] for problem in diagnostics.problems]))
"""


def install(folder: Path, package: str, source: str, entry: str) -> None:
    """A package as a user would install it: a module and its entry point."""
    (folder / f"{package}.py").write_text(source)
    metadata = folder / f"{package}-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(entry)


def run(folder: Path, program: str) -> Any:
    environment = os.environ | {"PYTHONPATH": str(folder)}
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, env=environment)
    assert process.returncode == 0, process.stderr
    return json.loads(process.stdout)


BROKEN = {
    "theirs": ("import not_installed_anywhere", "not_installed_anywhere"),
    "raising": ("raise RuntimeError('no licence')", "no licence"),
    "ending": ("import sys; sys.exit('no right')", "no right"),
    "nothing": ("PLUGIN = None", "AttributeError"),
    "missing": ("NOTHING = 1", "PLUGIN"),
    "unreadable": (
        "class C:\n  name = 'unreadable'\n  @property\n  def scenarios(self): raise OSError('no file')\nPLUGIN = C()",
        "no file",
    ),
}
"""By name of a catalogue: the source of its package, and what its error says."""


@pytest.mark.slow
def test_broken_catalogues_are_listed_with_their_errors_and_nothing_else_fails(tmp_path: Path) -> None:
    for name, (source, _) in BROKEN.items():
        install(tmp_path, f"{name}_package", source, f"[drivecal.scenarios]\n{name} = {name}_package:PLUGIN\n")
    answer = run(tmp_path, LISTS)
    assert (answer["catalogues"], answer["functions"], answer["one"]) == (["highway"], ["frenet"], "highway")
    errors = {name: (group, package, error) for group, name, package, error in answer["broken"]}
    assert errors.keys() == BROKEN.keys()
    assert len(answer["broken"]) == len(answer["all"]) == len(BROKEN)
    for name, (_, words) in BROKEN.items():
        group, package, error = errors[name]
        assert (group, package) == ("drivecal.scenarios", f"{name}_package")
        assert words in error
    fields, remedy = answer["named"]
    assert fields == ["catalogue"]
    assert "theirs_package" in remedy


@pytest.mark.slow
def test_a_broken_driving_function_leaves_the_others_listed(tmp_path: Path) -> None:
    entry = "[drivecal.driving_functions]\nmine = mine:PLUGIN\n[drivecal.vehicles]\nmine = mine:PLUGIN\n"
    install(tmp_path, "mine", "import not_installed_anywhere", entry)
    answer = run(tmp_path, LISTS)
    assert answer["functions"] == ["frenet"]
    assert [name for _, name, _, _ in answer["broken"]] == ["mine"]
    assert len(answer["all"]) == 2


@pytest.mark.slow
def test_a_name_that_two_packages_register_is_refused_with_both(tmp_path: Path) -> None:
    install(tmp_path, "first", EMPTY, "[drivecal.scenarios]\ntheirs = first:PLUGIN\n")
    install(tmp_path, "second", EMPTY, "[drivecal.scenarios]\ntheirs = second:PLUGIN\n")
    answer = run(tmp_path, LISTS)
    ((_, name, package, error),) = answer["broken"]
    assert (name, package) == ("theirs", "first, second")
    assert "first:PLUGIN" in error
    assert "second:PLUGIN" in error
    assert answer["named"][0] == ["catalogue"]


def test_a_scenario_id_of_two_catalogues_is_refused_with_both_names(tmp_path: Path) -> None:
    """The last catalogue won in silence."""
    install(tmp_path, "theirs", THEIRS_HAS_S1, "[drivecal.scenarios]\ntheirs = theirs:PLUGIN\n")
    ((field, message),) = run(tmp_path, BY_ID)
    assert field == "catalogue[1]"
    assert "highway" in message
    assert "theirs" in message


def test_a_plugin_of_another_package_is_found(tmp_path: Path) -> None:
    install(tmp_path, "theirs", EMPTY, "[drivecal.scenarios]\ntheirs = theirs:PLUGIN\n")
    program = "import json; from drivecal.plugins import registry as r; print(json.dumps([r.catalogue('theirs').name, r.names('{}')]))"
    assert run(tmp_path, program.format("drivecal.scenarios")) == ["theirs", ["highway", "theirs"]]


PLAIN = """
class PLUGIN:
    name = "plain"
    class settings:
        model_fields = {}
"""


@pytest.mark.slow
def test_an_optimizer_that_does_not_say_what_it_searches_is_broken(tmp_path: Path) -> None:
    install(tmp_path, "plain", PLAIN, "[drivecal.optimizers]\nplain = plain:PLUGIN\n")
    (told,) = run(tmp_path, LISTS)["all"]
    assert "no attribute 'supports'" in told
