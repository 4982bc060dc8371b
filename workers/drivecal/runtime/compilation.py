"""Folder of numba's compiled kernels, with which workers start in a fraction of a second."""

import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

from drivecal.runtime.cache import writable_folder

SHIPPED = "DRIVECAL_KERNELS"
"""Environment variable: a folder with compiled kernels inside an image. Images are read-only, so that the kernels are copied."""


def prepare_cache() -> None:
    """Sets a folder for compiled kernels if numba cannot store them next to the sources. Call it before importing numba.

    If drivecal is installed read-only, they are stored in the user's cache folder or, if that is not writable (containers, service
    accounts), in a temporary one. Simulators get the folder's name: they have another home. Several processes may share each of these
    folders, because files are replaced atomically.

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
    if not os.access(sources, os.W_OK):
        os.environ["NUMBA_CACHE_DIR"] = str(writable_folder("~/.cache/numba", "drivecal-numba"))


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
