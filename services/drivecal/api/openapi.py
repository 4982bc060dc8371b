"""The OpenAPI document: FastAPI's own with additions."""

from typing import Any

from fastapi import FastAPI

from drivecal.api.http.authorisation import OPEN

EVENTS = "text/event-stream"


def describe(app: FastAPI, *, asks_for_tokens: bool) -> None:
    """Completes the document that `app` shows."""
    made: dict[str, Any] = {}

    def document() -> dict[str, Any]:
        if not made:
            made.update(FastAPI.openapi(app))
            _complete(made)
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
