"""Dependencies are locked, and the tools that guard the code are set as strictly as they claim."""

import re
import tokenize
import tomllib
from functools import cache
from io import StringIO
from typing import Any

import hypothesis
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from tests.support.effort import LONG
from tests.support.tree import PROJECT, modules, shown

LOCK = PROJECT / "deploy" / "requirements.lock"


@cache
def project() -> dict[str, Any]:
    with (PROJECT / "pyproject.toml").open("rb") as file:
        return tomllib.load(file)


def declared() -> list[Requirement]:
    table = project()
    lists = [table["project"]["dependencies"], *table["project"]["optional-dependencies"].values()]
    lists += table["dependency-groups"].values()
    lists.append(table["build-system"]["requires"])
    return [Requirement(entry) for entries in lists for entry in entries if not entry.startswith("drivecal[")]


def test_properties_try_the_same_examples_everywhere_unless_the_long_form_is_chosen() -> None:
    assert hypothesis.settings().derandomize is not LONG


@cache
def locked() -> dict[str, list[tuple[str, int]]]:
    """Version and number of hashes of each locked package, by name; several where platforms differ."""
    result: dict[str, list[tuple[str, int]]] = {}
    entries = LOCK.read_text(encoding="utf-8").replace("\\\n", " ").splitlines()
    for entry in entries:
        if entry.strip() and not entry.lstrip().startswith("#"):
            requirement, *hashes = entry.split("--hash=")
            match = re.fullmatch(r"([A-Za-z0-9_.-]+)(?:\[[^]]*\])?==([^\s;]+)\s*(?:;.*)?", requirement.strip())
            assert match is not None
            name, version = match.groups()
            result.setdefault(canonicalize_name(name), []).append((version, len(hashes)))
    return result


@pytest.mark.parametrize("requirement", declared(), ids=str)
def test_what_is_declared_is_locked_at_a_version_that_fits(requirement: Requirement) -> None:
    versions = [version for version, _ in locked().get(canonicalize_name(requirement.name), [])]
    assert versions, f"{requirement.name} is not locked; run make lock"
    assert all(requirement.specifier.contains(version) for version in versions)


def test_everything_locked_is_locked_by_its_hash() -> None:
    assert locked()
    assert [name for name, entries in locked().items() if not all(hashes for _, hashes in entries)] == []


def test_the_lock_names_no_place_to_download_from() -> None:
    assert not re.search(r"https?://|^-i |--index-url|--find-links", LOCK.read_text(encoding="utf-8"), re.MULTILINE)


def test_types_are_checked_strictly_and_everywhere() -> None:
    mypy = project()["tool"]["mypy"]
    assert mypy["strict"]
    assert mypy["explicit_package_bases"]
    assert set(mypy["files"]) == {"shared", "services", "workers", "tests", "docs", "deploy/audit.py"}
    assert set(mypy["mypy_path"]) >= {"shared", "services", "workers"}
    relaxed = {key for override in mypy.get("overrides", []) for key in override} - {"module"}
    assert relaxed <= {"ignore_missing_imports", "follow_untyped_imports", "disallow_untyped_decorators", "warn_return_any"}


def test_the_linter_knows_the_three_roots() -> None:
    assert project()["tool"]["ruff"]["src"] == ["shared", "services", "workers"]
    assert project()["tool"]["hatch"]["build"]["dev-mode-dirs"] == ["shared", "services", "workers"]


def test_every_rule_of_the_linter_that_is_off_has_its_reason_beside_it() -> None:
    text = (PROJECT / "pyproject.toml").read_text(encoding="utf-8")
    section = text[text.index("\nignore = [") : text.index("[tool.mypy]")]
    rules = [line for line in section.splitlines() if re.search(r'"[A-Z]+[0-9]*"', line)]
    assert rules
    assert [line for line in rules if "#" not in line] == []


EXCEPTION = re.compile(r"#\s*(noqa|type:\s*ignore)")
REASONED = re.compile(r"# noqa: [A-Z]+[0-9]+(, [A-Z]+[0-9]+)*\s+(# )?\S+ \S|# type: ignore\[[a-z-]+(, [a-z-]+)*\]\s+# \S+ \S")


def unreasoned(text: str) -> list[str]:
    """The comments that make an exception and name no rule or no reason."""
    if not EXCEPTION.search(text):  # finding the comments takes a hundred times as long
        return []
    tokens = tokenize.generate_tokens(StringIO(text).readline)
    exceptions = [token.string for token in tokens if token.type == tokenize.COMMENT and EXCEPTION.search(token.string)]
    return [comment for comment in exceptions if not REASONED.search(comment)]


def test_every_exception_in_the_code_names_its_rule_and_its_reason() -> None:
    """`# noqa: RULE  why` and `# type: ignore[rule]  # why`."""
    paths = [*modules(), *sorted((PROJECT / "tests").rglob("*.py"))]
    wrong = {shown(path): unreasoned(path.read_text(encoding="utf-8")) for path in paths}
    assert {name: comments for name, comments in wrong.items() if comments} == {}
    assert unreasoned("import os  # " + "noqa: F401\n") == ["# " + "noqa: F401"], "one without a reason would be found"
