"""Links of the OpenAPI document: each id that an operation takes, some other operation gives."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest

from drivecal.api.app import create_app
from drivecal.api.document import SOURCES
from drivecal.configuration.settings import load_settings

METHODS = {"get", "post", "put", "patch", "delete"}


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The paths of the document."""
    database = tmp_path_factory.mktemp("links") / "never-made.db"
    document: dict[str, Any] = create_app(load_settings(database_url=f"sqlite:///{database}")).openapi()["paths"]
    return document


def links(paths: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """All links."""
    for operations in paths.values():
        for operation in operations.values():
            for answer in operation["responses"].values():
                yield from answer.get("links", {}).values()


def test_every_operation_that_takes_an_id_can_be_reached_from_another_that_gives_it(paths: dict[str, Any]) -> None:
    taking = {
        operation["operationId"]: set(re.findall(r"\{(\w+)\}", path))
        for path, operations in paths.items()
        for method, operation in operations.items()
        if method in METHODS and "{" in path
    }
    assert len(taking) > 30
    reached: dict[str, set[str]] = {}
    for link in links(paths):
        reached.setdefault(link["operationId"], set()).update(link["parameters"])
    assert reached == taking


def test_names_of_sources_are_those_of_parameters(paths: dict[str, Any]) -> None:
    assert SOURCES.keys() == {name for path in paths for name in re.findall(r"\{(\w+)\}", path)}
