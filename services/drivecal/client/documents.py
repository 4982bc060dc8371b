"""Bodies of calls: documents of users."""

import json
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from typing import Any

from pydantic import BaseModel

from drivecal.configuration.documents import read_document
from drivecal.contracts.outside.sets import MOST_SETS
from drivecal.domain.errors import InvalidInputError, Problem

Document = Mapping[str, Any] | BaseModel | str | PathLike[str]
"""A submitted document: plain data, a specification of `drivecal.contracts`, or the path of a YAML or JSON file."""
LARGEST_PIECE = 200_000
"""Bytes. The server takes a megabyte and 100,000 values, each of two bytes or more."""


def plain(document: Document) -> Mapping[str, Any]:
    """Returns the body of a call. Raises InvalidInputError as `read_document`."""
    if isinstance(document, BaseModel):
        return document.model_dump(mode="json", exclude_unset=True)
    if isinstance(document, (str, PathLike)):
        return read_document(str(document))
    try:
        return dict(json.loads(json.dumps(dict(document), default=listed)))
    except (TypeError, ValueError) as error:
        raise InvalidInputError(Problem("", str(error), "give a mapping of texts, numbers, lists and mappings")) from error


def listed(value: Any) -> Any:
    """Returns numbers and arrays of numpy as numbers and lists, and further mappings. Raises TypeError for what is no number."""
    return value.tolist() if hasattr(value, "tolist") else dict(value) if isinstance(value, Mapping) else float(value)


def query_of(given: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the parameters of a query that have a value; weights are written `S1=2,S2=1`."""
    known = {name: value for name, value in given.items() if value is not None}
    weights = {name: value.items() for name, value in known.items() if isinstance(value, Mapping)}
    return known | {name: ",".join(f"{each}={float(weight)!r}" for each, weight in pairs) for name, pairs in weights.items()}


def in_pieces(items: Sequence[Mapping[str, Any]]) -> Iterator[Sequence[Mapping[str, Any]]]:
    """Yields sets or rows in pieces that fit into a request, however long their lists are."""
    longest = max((len(json.dumps(each)) for each in items), default=1)
    size = max(1, min(MOST_SETS, LARGEST_PIECE // longest))
    for start in range(0, len(items), size):
        yield items[start : start + size]
