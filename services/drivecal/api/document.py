"""The OpenAPI document: FastAPI's own with additions."""

import re
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from fastapi import FastAPI

from drivecal.api.http.authorisation import OPEN
from drivecal.api.responses import ROOT
from drivecal.api.routes.page_live import PROTOCOL


class IdSource(NamedTuple):
    """A place of an answer that holds an id, and the paths for which the id is usable."""

    method: str
    path: str
    status: str
    pointer: str
    """JSON pointer (RFC 6901) into the body."""
    usable: str = ""
    """Pattern of the rest of a path, behind the id; empty: any."""


SOURCES: Mapping[str, tuple[IdSource, ...]] = {
    "campaign_id": (
        IdSource("post", "/campaigns", "202", "/id"),
        IdSource("get", "/campaigns", "200", "/items/0/id"),
        IdSource("post", "/campaigns/{campaign_id}/rerun", "202", "/id"),
        IdSource("post", "/comparisons", "202", "/runs/0/campaign"),
    ),
    "tag": (IdSource("post", "/comparisons", "202", "/tag"),),
    "evaluation_id": (
        IdSource("post", "/evaluations", "202", "/id"),
        IdSource("get", "/campaigns/{campaign_id}/evaluations", "200", "/items/0/id"),
    ),
    "map_id": (IdSource("post", "/influence-maps", "201", "/id"), IdSource("get", "/influence-maps", "200", "/items/0/id")),
    "problem": (
        IdSource("post", "/problems", "201", "/digest"),
        IdSource("post", "/problems", "200", "/digest"),
        IdSource("get", "/problems", "200", "/items/0/digest"),
    ),
    "scenario_id": (IdSource("get", "/scenarios", "200", "/items/0/id"),),
    "view_id": (IdSource("post", "/views", "201", "/id"), IdSource("get", "/views", "200", "/items/0/id")),
}
"""The answers with an id, by the name that paths have for it."""


def add_links(paths: Mapping[str, Any]) -> None:
    """Adds to each of these answers a link to every operation that its id is usable for, named after the operation."""
    for name, sources in SOURCES.items():
        for source in sources:
            answer = paths[ROOT + source.path][source.method]["responses"][source.status]
            answer["links"] = {
                operation: {"operationId": operation, "parameters": {name: f"$response.body#{source.pointer}"}}
                for operation in _taking(paths, name, source.usable)
            }


def _taking(paths: Mapping[str, Any], name: str, usable: str) -> Iterator[str]:
    """Yields the operations with this parameter in their path whose rest begins with the pattern."""
    for path, operations in paths.items():
        _, parameter, rest = path.partition(f"{{{name}}}")
        if parameter and re.match(usable, rest):
            yield from (operation["operationId"] for operation in operations.values())


EVENTS = "text/event-stream"


def describe(app: FastAPI, *, asks_for_tokens: bool) -> None:
    """Completes the document that `app` shows."""
    made: dict[str, Any] = {}

    def document() -> dict[str, Any]:
        if not made:
            made.update(FastAPI.openapi(app))
            _complete(made)
            add_links(made["paths"])
            made["tags"] = [{"name": "page", "description": PROTOCOL}]
            if asks_for_tokens:
                _ask_for_tokens(made)
        return made

    app.openapi = document  # type: ignore[method-assign]  # FastAPI's own way to extend it


def _complete(node: object) -> None:
    """Completes schemas: objects with patterned keys refuse others, and event streams describe their events."""
    if isinstance(node, dict):
        if "patternProperties" in node:
            node.setdefault("additionalProperties", False)
        if EVENTS in node:
            node[EVENTS] = {"schema": _event(node[EVENTS].get("schema", {}))}
        for inner in node.values():
            _complete(inner)
    elif isinstance(node, list):
        for inner in node:
            _complete(inner)


def _event(data: dict[str, Any]) -> dict[str, Any]:
    """Returns the schema of a stream's event, with JSON text as data; before OpenAPI 3.2 it stands for the stream."""
    content = {key: value for key, value in data.items() if key not in {"type", "title"}}
    text = {"type": "string"}
    parts = {"id": text, "event": text, "data": text | {"contentMediaType": "application/json", "contentSchema": content}}
    return {"type": "object", "properties": parts, "required": ["data"]}


def _ask_for_tokens(document: dict[str, Any]) -> None:
    scheme = {"type": "http", "scheme": "bearer", "description": "A token of the server's tokens file"}
    document.setdefault("components", {})["securitySchemes"] = {"token": scheme}
    document["security"] = [{"token": []}]
    for path in OPEN & document["paths"].keys():
        for operation in document["paths"][path].values():
            operation["security"] = []
