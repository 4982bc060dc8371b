"""Bodies of calls: documents of users."""

from collections.abc import Mapping
from os import PathLike
from typing import Any

from pydantic import BaseModel

from drivecal.configuration.documents import read_document

Document = Mapping[str, Any] | BaseModel | str | PathLike[str]
"""A submitted document: plain data, a specification of `drivecal.contracts`, or the path of a YAML or JSON file."""


def plain(document: Document) -> Mapping[str, Any]:
    """Returns the body of a call. Raises InvalidInputError as `read_document`."""
    if isinstance(document, BaseModel):
        return document.model_dump(mode="json", exclude_unset=True)
    return document if isinstance(document, Mapping) else read_document(str(document))


def weights_text(weights: Mapping[str, float] | str | None) -> str | None:
    """Returns weights as a query has them: `S1=2,S2=1`."""
    if isinstance(weights, Mapping):
        return ",".join(f"{name}={weight:.12g}" for name, weight in weights.items())
    return weights
