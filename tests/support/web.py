"""The build hook of the page, which is no module of any package."""

from __future__ import annotations

import importlib.util
from types import ModuleType

from tests.support.tree import PROJECT


def hook() -> ModuleType:
    """`services/web/build_hook.py`, loaded anew."""
    spec = importlib.util.spec_from_file_location("build_hook", PROJECT / "services" / "web" / "build_hook.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
