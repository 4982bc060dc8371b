"""Folder of numba's compiled kernels, with which workers start in a fraction of a second."""

import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

from drivecal.runtime.cache import temporary_folder

SHIPPED = "DRIVECAL_KERNELS"
"""Environment variable: a folder with compiled kernels inside an image. Images are read-only, so that the kernels are copied."""


def prepare_cache() -> None:
    """Sets a folder for compiled kernels if numba has none. Call it before importing numba.

    numba stores kernels next to the sources or, if drivecal is installed read-only, in the user's cache folder. Several processes may share
    either folder, because files are replaced atomically. If neither is writable (containers, service accounts), numba would refuse to
    compile. The processes of the user then share a temporary folder.

    If `NUMBA_CACHE_DIR` names a folder that does not exist yet, it is created as a copy of the image's kernels (`DRIVECAL_KERNELS`). numba
    recompiles kernels of other processors.
    """
    folder = os.environ.get("NUMBA_CACHE_DIR")
    if folder:
        shipped = Path(os.environ.get(SHIPPED) or os.devnull)
        if shipped.is_dir():
            _copy_kernels(shipped, Path(folder))
        return
    sources = Path(__file__).parent
    if not os.access(sources, os.W_OK) and not _is_writable("~/.cache/numba"):
        os.environ["NUMBA_CACHE_DIR"] = str(temporary_folder("drivecal-numba"))


def _copy_kernels(shipped: Path, folder: Path) -> None:
    """Copies the kernels unless the folder exists. Atomic, because workers of a node start concurrently."""
    if folder.exists():
        return
    folder.parent.mkdir(parents=True, exist_ok=True)
    copy = Path(tempfile.mkdtemp(prefix=folder.name, dir=folder.parent))
    shutil.copytree(shipped, copy, dirs_exist_ok=True)
    with suppress(OSError):
        copy.rename(folder)
    shutil.rmtree(copy, ignore_errors=True)


def _is_writable(path: str) -> bool:
    try:
        folder = Path(path).expanduser()
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # a user without a home
        return False
    return os.access(folder, os.W_OK)
