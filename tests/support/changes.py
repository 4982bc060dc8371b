"""Documents with one change, for tests of what is refused, modules with another library, and plug-ins that tests install."""

import copy
from collections.abc import Mapping
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from drivecal.plugins import registry


def replace_in(monkeypatch: pytest.MonkeyPatch, module: ModuleType, library: str, **functions: Any) -> None:
    """Replaces functions of a library, such as `time`, for one module. Threads of other tests in this process use the library itself."""
    namespace = SimpleNamespace(**vars(getattr(module, library)) | functions)
    monkeypatch.setattr(module, library, namespace)


def install(monkeypatch: pytest.MonkeyPatch, kind: str, plugin: Any) -> None:
    """Adds a plug-in to the others of its `kind`, such as `evaluator`."""
    known = getattr(registry, kind)
    monkeypatch.setattr(registry, kind, lambda name: plugin if name == plugin.name else known(name))


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
