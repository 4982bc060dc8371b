"""Where numba keeps what it compiled, so that workers start in a fraction of a second."""

from __future__ import annotations

import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

SHIPPED = "DRIVECAL_KERNELS"
"""Environment variable: a folder with compiled kernels that an image brought along. Nobody can write into an image, so they are copied."""


def prepare_cache() -> None:
    """Gives numba a folder for compiled kernels where it would find none itself. To be called before numba is imported.

    numba keeps them beside the sources, or, where drivecal is installed read-only, in the user's cache folder; several processes may
    share either, for files are replaced in one step. Without a writable one of the two (containers, service accounts) it would refuse
    to compile: then they go into a new temporary folder that only this process knows, which costs the compilation at every start.

    Where `NUMBA_CACHE_DIR` names a folder that does not exist yet, it begins with what an image brought along (`DRIVECAL_KERNELS`). numba
    compiles anew what was compiled for another processor.
    """
    folder = os.environ.get("NUMBA_CACHE_DIR")
    if folder:
        shipped = Path(os.environ.get(SHIPPED) or os.devnull)
        if shipped.is_dir():
            _begin_with(Path(folder), shipped)
        return
    beside_sources = Path(__file__).parent
    if not os.access(beside_sources, os.W_OK) and not _can_be_made(Path("~/.cache/numba").expanduser()):
        os.environ["NUMBA_CACHE_DIR"] = tempfile.mkdtemp(prefix="drivecal-numba-")


def _begin_with(folder: Path, shipped: Path) -> None:
    """In one step, for workers of one node start at the same time; who comes second finds it there."""
    if folder.exists():
        return
    folder.parent.mkdir(parents=True, exist_ok=True)
    copy = Path(tempfile.mkdtemp(prefix=folder.name, dir=folder.parent))
    shutil.copytree(shipped, copy, dirs_exist_ok=True)
    with suppress(OSError):
        copy.rename(folder)
    shutil.rmtree(copy, ignore_errors=True)


def _can_be_made(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)
