"""Where numba keeps what it compiled, so that workers start in a fraction of a second."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


def prepare_cache() -> None:
    """Gives numba a folder for compiled kernels where it would find none itself. To be called before numba is imported.

    numba keeps them beside the sources, or, where drivecal is installed read-only, in the user's cache folder; several processes may
    share either, for files are replaced in one step. Without a writable one of the two (containers, service accounts) it would refuse
    to compile: then they go into a new temporary folder that only this process knows, which costs the compilation at every start.
    """
    if os.environ.get("NUMBA_CACHE_DIR"):
        return
    beside_sources = Path(__file__).parent
    if not os.access(beside_sources, os.W_OK) and not _can_be_made(Path("~/.cache/numba").expanduser()):
        os.environ["NUMBA_CACHE_DIR"] = tempfile.mkdtemp(prefix="drivecal-numba-")


def _can_be_made(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)
