"""The OpenAPI document's links (OpenAPI 3.1.1, Section 4.8.20): answers that hold the ids which other operations take."""

import re
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from drivecal.api.responses import ROOT


class Source(NamedTuple):
    """A place of an answer that holds an id, and the paths for which the id is usable."""

    method: str
    path: str
    status: str
    pointer: str
    """JSON pointer (RFC 6901) into the body."""
    usable: str = ""
    """Pattern of the rest of a path, behind the id; empty: any."""


_NOT_OF_COMPARISONS = r"(?!/comparison)"
_OF_COMPARISONS = r"(|/(events|pause|resume|cancel|comparison.*))$"
"""A comparison has no search: other tables belong to its runs."""

SOURCES: Mapping[str, tuple[Source, ...]] = {
    "campaign_id": (
        Source("post", "/campaigns", "202", "/id", _NOT_OF_COMPARISONS),
        Source("get", "/campaigns", "200", "/items/0/id", _NOT_OF_COMPARISONS),
        Source("post", "/campaigns/{campaign_id}/rerun", "202", "/id", _NOT_OF_COMPARISONS),
        Source("post", "/comparisons", "202", "/id", _OF_COMPARISONS),
        Source("get", "/campaigns/{campaign_id}/comparison", "200", "/items/0/run", _NOT_OF_COMPARISONS),
    ),
    "evaluation_id": (
        Source("post", "/evaluations", "202", "/id"),
        Source("get", "/campaigns/{campaign_id}/evaluations", "200", "/items/0/id"),
    ),
    "map_id": (Source("post", "/influence-maps", "201", "/id"), Source("get", "/influence-maps", "200", "/items/0/id")),
    "problem": (
        Source("post", "/problems", "201", "/digest"),
        Source("post", "/problems", "200", "/digest"),
        Source("get", "/problems", "200", "/items/0/digest"),
    ),
    "scenario_id": (Source("get", "/scenarios", "200", "/items/0/id"),),
    "view_id": (Source("post", "/views", "201", "/id"), Source("get", "/views", "200", "/items/0/id")),
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
        _, found, rest = path.partition(f"{{{name}}}")
        if found and re.match(usable, rest):
            yield from (operation["operationId"] for operation in operations.values())
