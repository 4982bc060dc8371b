"""Bodies of calls: documents of users, with the full ids of what they name."""

import re
from collections.abc import Callable, Iterable, Mapping
from itertools import islice
from os import PathLike
from typing import Any

from pydantic import BaseModel

from drivecal.configuration.documents import read_document
from drivecal.domain.errors import NotFoundError

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


_ABBREVIATION = re.compile(r"[0-9a-f]{4,31}")
_TOO_SHORT = re.compile(r"[0-9a-f]{1,3}")

Complete = Callable[[str], str]


def is_abbreviated(identifier: str) -> bool:
    """Returns whether an identifier can be the beginning of an id."""
    return _ABBREVIATION.fullmatch(identifier) is not None


def completed(kind: str, identifier: str, ids: Iterable[str]) -> str:
    """Returns the only one of the `ids` that begins with `identifier`, or an unknown `identifier` itself.

    Raises NotFoundError if several begin so, or if it is too short to be meant.
    """
    if _TOO_SHORT.fullmatch(identifier):
        raise NotFoundError(f"single {kind}", identifier, "give at least four characters of its id")
    if not is_abbreviated(identifier):
        return identifier
    matching = list(islice((full for full in ids if full.startswith(identifier)), 2))
    if len(matching) > 1:
        raise NotFoundError(f"single {kind}", identifier, "several ids begin so; give more characters")
    return matching[0] if matching else identifier


def with_full_ids(specification: Mapping[str, Any], campaign: Complete, influence_map: Complete) -> Mapping[str, Any]:
    """Returns a specification with full ids of the influence map and the campaigns that it names."""
    full = dict(specification)
    for section, name, complete in (
        ("sensitivity", "map", influence_map),
        ("robustness", "of", campaign),
        ("validation", "of", campaign),
    ):
        settings = full.get(section)
        if isinstance(settings, Mapping) and isinstance(settings.get(name), str):
            full[section] = {**settings, name: complete(settings[name])}
    for section in ("objectives", "constraints"):
        if isinstance(goals := full.get(section), list):
            full[section] = [_with_full_set(goal, campaign) if isinstance(goal, Mapping) else goal for goal in goals]
    return full


def _with_full_set(goal: Mapping[str, Any], campaign: Complete) -> dict[str, Any]:
    """Returns a goal with the full id of the campaign whose set, `ID` or `ID#2`, it compares with."""
    sets = {name: goal[name] for name in ("changes", "distance") if isinstance(goal.get(name), str)}
    return {**goal, **{name: re.sub("^[^#]*", lambda begin: campaign(begin[0]), given) for name, given in sets.items()}}
