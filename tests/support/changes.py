"""Documents with one change, for tests of what is refused."""

import copy
from collections.abc import Mapping
from typing import Any


def with_change(document: Mapping[str, Any], path: str, value: Any) -> dict[str, Any]:
    """Returns a copy with the value at a path, e.g. `scenarios/merge/route/0`, changed, or removed if it is None."""
    given = copy.deepcopy(dict(document))
    *parents, last = path.split("/")
    inner: Any = given
    for part in parents:
        inner = inner[int(part) if isinstance(inner, list) else part]
    if value is None:
        del inner[last]
    else:
        inner[int(last) if isinstance(inner, list) else last] = value
    return given
