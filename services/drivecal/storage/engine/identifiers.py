"""Identifiers of campaigns and influence maps."""

import re

_FORM = re.compile(r"[0-9a-f]{32}")


def is_identifier(text: str) -> bool:
    """Whether `text` could name a stored campaign or map. Anything may come in a URL, also what a database cannot even compare
    (PostgreSQL refuses text with a NUL)."""
    return _FORM.fullmatch(text) is not None
