"""The version of SUMO, which is part of setups. Read without importing it."""

from functools import cache
from importlib.metadata import PackageNotFoundError, version


def sumo() -> str:
    """Returns SUMO's library and its version as installed now, without importing it."""
    try:
        return f"libsumo {version('libsumo')}"
    except PackageNotFoundError:
        return "libsumo not installed"


loaded_sumo = cache(sumo)
"""Returns the same as at its first call: a process keeps the library that it has loaded."""
