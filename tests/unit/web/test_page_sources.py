"""The page's own sources: their unit tests, where what runs them is there; words that the glossary explains; texts of existing fields."""

import json
import re
from collections.abc import Iterator
from typing import Any

import pytest
from tests.support.tree import PROJECT
from tests.support.web import WEB

from drivecal.contracts.comparison import ComparisonSpecification
from drivecal.contracts.specification import CampaignSpecification
from drivecal.domain.events import EventKind
from drivecal.plugins import registry

FIELDS = json.loads((PROJECT / "services" / "web" / "src" / "lib" / "forms" / "fields.json").read_text())
GROUPS = {
    "vehicle.model": "vehicles",
    "evaluator": "evaluators",
    "optimizer.kind": "optimizers",
    "optimizers[].kind": "optimizers",
}


def paths(schema: dict[str, Any], definitions: dict[str, Any], at: str = "") -> Iterator[str]:
    """All fields of a schema as the page names them."""
    if "$ref" in schema:
        yield from paths(definitions[schema["$ref"].rpartition("/")[2]], definitions, at)
    for variant in [*schema.get("anyOf", []), *schema.get("oneOf", [])]:
        yield from paths(variant, definitions, at)
    if "items" in schema:
        yield from paths(schema["items"], definitions, f"{at}[]")
    for name, inner in schema.get("properties", {}).items():
        path = f"{at}.{name}" if at else name
        yield path
        yield from paths(inner, definitions, path)


def test_the_page_listens_to_every_kind_of_event() -> None:
    source = (PROJECT / "services" / "web" / "src" / "lib" / "server" / "campaign.svelte.ts").read_text()
    [listed] = re.findall(r"^const KINDS = (\[.*\]);$", source, re.MULTILINE)
    assert set(json.loads(listed)) == set(EventKind)


def test_every_field_that_is_explained_exists() -> None:
    known: set[str] = set()
    for model in (CampaignSpecification, ComparisonSpecification):
        schema = model.model_json_schema()
        known.update(paths(schema, schema["$defs"]))
    assert set(FIELDS["help"]) | set(FIELDS["names"]) <= known


@pytest.mark.parametrize("path", sorted(GROUPS))
def test_every_plug_in_that_comes_with_drivecal_can_be_chosen(path: str) -> None:
    left_out = {"external"} if path == "optimizers[].kind" else set()  # comparisons refuse it
    assert sorted({*FIELDS["names"][path], *left_out}) == registry.names(f"drivecal.{GROUPS[path]}")


def test_every_word_that_the_page_explains_is_in_the_glossary() -> None:
    headings = re.findall(r"^## (.+)$", (PROJECT / "docs/pages/concepts/glossary.md").read_text(), re.MULTILINE)
    anchors = {heading.lower().replace(" ", "-") for heading in headings}
    terms = set(re.findall(r'^  "?([\w-]+)"?: "', (WEB / "src/lib/text/terms.ts").read_text(), re.MULTILINE))
    assert len(terms) > 5
    assert terms - anchors == set()
