"""Compilation of kernels that call kernels of other modules.

numba stores compiled functions, and takes them for current as long as their own file does not change; a kernel that it called from another
module may have changed long since. Plain `njit(cache=True)` is right for kernels that call no other module's.
"""

from collections.abc import Callable, Iterable
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import Any

from numba import njit


def digest_of(modules: Iterable[ModuleType]) -> str:
    """Returns the digest of these modules' sources, in any order."""
    paths = sorted(str(module.__file__) for module in modules)
    return sha256(b"".join(Path(path).read_bytes() for path in paths)).hexdigest()


def compiled_with(*modules: ModuleType, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Returns a decorator like `njit(cache=True, **options)`, whose stored functions are current while `modules` do not change, either.

    `modules`: all modules whose kernels are called, directly or through others.
    """
    digest = digest_of(modules)

    def decorate(function: Callable[..., Any]) -> Any:
        kernel = njit(cache=True, **options)(function)
        index = vars(kernel._cache._cache_file)  # noqa: SLF001  # numba offers nothing public; a test edits a called module
        index["_source_stamp"] = (*index["_source_stamp"], digest)
        return kernel

    return decorate
