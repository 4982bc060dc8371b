"""Opaque cursors: where the next page of a list begins."""

import base64
import binascii
import json
from typing import Any

from drivecal.domain.errors import InvalidInputError, Problem


def encode(*position: int | str) -> str:
    """The cursor that names the last row of a page by the values that the list is sorted by."""
    return base64.urlsafe_b64encode(json.dumps(position, separators=(",", ":")).encode()).decode().rstrip("=")


def decode(cursor: str, *kinds: type[int | str]) -> tuple[Any, ...]:
    """The inverse of `encode` for values of these `kinds`. Raises InvalidInputError if the cursor is not one of ours."""
    try:
        position = json.loads(base64.b64decode(cursor + "=" * (-len(cursor) % 4), altchars=b"-_", validate=True))
    except (binascii.Error, ValueError, RecursionError):
        position = None
    if isinstance(position, list) and len(position) == len(kinds):
        fits = all(type(value) is kind for value, kind in zip(position, kinds, strict=True))
        if fits and all(0 <= value < 2**31 if isinstance(value, int) else value.isprintable() for value in position):
            return tuple(position)
    raise InvalidInputError(Problem("cursor", "it does not come from this list", "give `next_cursor` of the page before"))
