"""Tests of what the documentation shows can be typed: commands exist with their options, files are valid, Python compiles."""

import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer
from pydantic import TypeAdapter, ValidationError
from tests.architecture.plain_words import phrases_in
from tests.support.documentation import DOCS, PAGES, Block, blocks, program

from drivecal.bundles.archives import content_digest, files_digest
from drivecal.bundles.checks import checked
from drivecal.bundles.highway_checks import scenarios_problems
from drivecal.bundles.installed import Bundle, installed
from drivecal.bundles.manifest import AnySimulator
from drivecal.campaigns.comparison import resolve_comparison
from drivecal.campaigns.resolve.maps import resolve_map
from drivecal.campaigns.resolve.problem import resolve
from drivecal.cli.__main__ import app
from drivecal.cli.commands.check import LimitsFile
from drivecal.configuration.documents import read_document
from drivecal.configuration.problems import read_bundle
from drivecal.contracts.comparison import ComparisonSpecification
from drivecal.contracts.input_errors import validated
from drivecal.contracts.specification import CampaignSpecification, InfluenceMapSpecification
from drivecal.contracts.strict_yaml import located_yaml
from drivecal.domain.errors import InvalidInputError
from drivecal.highway.planner.plugin import RANGES

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted([*(ROOT / "deploy" / "examples").glob("*.yaml"), *(ROOT / "deploy" / "examples" / "maps").glob("*.yaml")])


def shown_commands() -> Iterator[tuple[Path, list[str]]]:
    """The words of every command line in the code blocks of the pages."""
    for page in PAGES:
        for block in (item for item in blocks(page) if item.language != "text"):
            for line in block.text.replace("\\\n", " ").splitlines():
                try:
                    words = shlex.split(line.removeprefix("$ "), comments=True)
                except ValueError:  # prose or output with an apostrophe
                    continue
                while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
                    words.pop(0)
                if words and Path(words[0]).name in {"drivecal", "make"}:
                    end = next((index for index, word in enumerate(words) if word in {"|", ">", "&", "&&", ";"}), len(words))
                    yield page, [Path(words[0]).name, *words[1:end]]


@cache
def drivecal() -> Any:
    """The command with all its subcommands."""
    return typer.main.get_command(app)


def parse(command: Any, name: str, words: list[str], parent: Any = None) -> None:
    """Raises where the command line does not take these words. Runs nothing."""
    context = command.make_context(name, list(words), parent=parent)
    rest = [*getattr(context, "_protected_args", []), *context.args]
    if hasattr(command, "resolve_command") and rest:
        name, subcommand, rest = command.resolve_command(context, rest)
        parse(subcommand, name, rest, context)


@pytest.mark.parametrize(
    ("page", "words"), list(shown_commands()), ids=lambda value: value.name if isinstance(value, Path) else " ".join(value)[:60]
)
def test_every_command_shown_in_the_documentation_can_be_typed(page: Path, words: list[str]) -> None:
    assert page.exists()
    if words[0] == "make":
        targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE))
        assert {word for word in words[1:] if not word.startswith("-")} <= targets
    else:
        parse(drivecal(), "drivecal", words[1:])


@pytest.mark.parametrize(
    "words", [["shwo", "x"], ["show"], ["show", "x", "--josn"], ["export", "x", "--format", "xml"], ["db", "upgrad"]]
)
def test_a_command_that_does_not_exist_would_be_noticed(words: list[str]) -> None:
    with pytest.raises(Exception, match=r"(?i)no such|missing|not one of"):
        parse(drivecal(), "drivecal", words)


def example(name: str) -> Bundle:
    """The bundle of an example folder, or an installed one."""
    if (own := installed(name)) is not None:
        return own
    manifest, archive = read_bundle(ROOT / "deploy" / "examples" / "problems" / name)
    return Bundle(content_digest(archive), files_digest(archive), manifest)


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda file: file.name)
def test_every_example_file_can_be_used(file: Path) -> None:
    document = read_document(str(file))
    if "scenarios" in document:
        assert resolve_map(validated(InfluenceMapSpecification, document))["scenarios"]
    elif "optimizers" in document:
        assert resolve_comparison(validated(ComparisonSpecification, document)).runs
    else:
        assert resolve(validated(CampaignSpecification, document), example).scenarios


def test_the_values_of_the_example_are_the_defaults_where_it_says_so() -> None:
    given = validated(CampaignSpecification, read_document(str(ROOT / "deploy" / "examples" / "highway.yaml")))
    chosen, usual = resolve(given).optimization, resolve(CampaignSpecification()).optimization
    assert chosen is not None
    assert usual is not None
    assert (chosen.settings, chosen.budget) == (usual.settings, usual.budget)
    theirs, own = resolve(given), resolve(CampaignSpecification())
    assert (theirs.bench.setups, theirs.bench.evaluator_id, theirs.space) == (
        own.bench.setups,
        own.bench.evaluator_id,
        own.space,
    )
    named = {"catalogue", "parameters"}
    sections = {
        name
        for name in CampaignSpecification.model_fields
        if name not in named and getattr(theirs.specification, name) != getattr(own.specification, name)
    }
    assert sections == {"name", "baseline", "weights"}


def test_the_built_in_parameters_are_told_as_they_are() -> None:
    page = DOCS / "pages" / "reference" / "motorway.md"
    shown = re.findall(r"^\| (P\d+) \| (\S+) to (\S+)(?: dB)? in steps of (\S+) \| (.+) \|$", page.read_text(), re.MULTILINE)
    assert shown == [(name, *texts[:3], texts[-1]) for name, *texts in RANGES]


def test_the_readme_is_read_in_a_minute() -> None:
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 120
    assert len(text.encode()) <= 9_000


def section(text: str, title: str) -> str:
    """The text below a heading of the second level."""
    (result,) = re.findall(rf"^## {re.escape(title)}\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    return str(result)


def test_the_numbers_of_the_readme_are_those_of_the_results() -> None:
    shown = section((ROOT / "README.md").read_text(), "Results")
    known = "\n".join(page.read_text() for page in (DOCS / "pages" / "results").glob("*.md"))
    numbers = set(re.findall(r"\d[\d,.]*\d", shown))
    assert len(numbers) > 12
    assert {number for number in numbers if not re.search(rf"(?<![\d.,]){re.escape(number)}(?!\d|[.,]\d)", known)} == set()


def test_readme_and_documentation_say_alike_what_fits() -> None:
    readme, start = (section(page.read_text(), "Does it fit?") for page in (ROOT / "README.md", DOCS / "pages" / "index.md"))
    assert start == readme.replace("](docs/pages/", "](")


BY_HAND = {"cluster.md", "index.md", "metrics.md"}
"""Pages of the reference that no program writes."""


@pytest.mark.slow
def test_the_reference_is_that_of_the_code() -> None:
    made = program("reference").pages()
    written = {path.name: path.read_text() for path in (DOCS / "pages" / "reference").glob("*.md") if path.name not in BY_HAND}
    assert written == made, "type: make docs"


def test_a_how_to_begins_with_what_it_needs_and_is_short() -> None:
    pages = {path.name: path.read_text() for path in (DOCS / "pages" / "how-to").glob("*.md")}
    assert len(pages) > 30
    assert [name for name, text in pages.items() if not re.match(r"# .+\n\nYou need: ", text)] == []
    words = {
        name: len(re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE).split()) for name, text in pages.items()
    }
    assert {name: count for name, count in words.items() if count > 700} == {}


def shown_in(language: str) -> list[Block]:
    """The blocks of a language on all pages."""
    return [block for page in PAGES for block in blocks(page) if block.language == language]


def test_files_of_the_project_are_shown_as_they_are() -> None:
    shown = {block.title: block.text for page in PAGES for block in blocks(page) if block.title.startswith("deploy/")}
    assert len(shown) >= 4
    assert shown == {name: (ROOT / name).read_text() for name in shown}, "type: make docs, and copy what it does not write"


@pytest.mark.parametrize("block", shown_in("python"), ids=str)
def test_python_in_the_documentation_compiles(block: Block) -> None:
    compile(block.text, str(block), "exec")


@pytest.mark.parametrize("block", shown_in("yaml"), ids=str)
def test_yaml_in_the_documentation_is_valid(block: Block) -> None:
    document, _ = located_yaml(block.text.encode())
    assert isinstance(document, dict)
    if "scores" in document:
        checked(document)
    elif "simulator" in document:
        TypeAdapter(AnySimulator).validate_python(document["simulator"])
    elif "scenarios" in document and "problem" in document:
        assert resolve_map(validated(InfluenceMapSpecification, document), example)["scenarios"]
    elif "scenarios" in document:
        assert list(scenarios_problems(0.1, document["scenarios"])) == []
    elif "optimizers" in document:
        validated(ComparisonSpecification, document)
    elif "limits" in document:
        validated(LimitsFile, document)
    elif "scrape_configs" not in document:  # a file of Prometheus
        validated(CampaignSpecification, document)


def test_wrong_yaml_would_be_noticed() -> None:
    for text in ("name: x\noptimiser: {}\n", "simulator: {kind: python}\n", "scores: {}\nproblem: x\n"):
        with pytest.raises((InvalidInputError, ValidationError)):
            test_yaml_in_the_documentation_is_valid(Block(ROOT, "yaml", "", text))


def test_there_are_no_unclear_phrases() -> None:
    assert [str(phrase) for phrase in phrases_in()] == []
