"""Compilation of kernels. All are stored, and compiled again when their own file, or one whose kernels they call, has changed.

numba itself takes a stored function for current as long as its own file does not change; a kernel that it called from another module may
have changed long since. And it writes the index of stored functions before the function, to a file that an earlier source may have left:
a process that starts in between loads the earlier one.
"""

from collections.abc import Callable, Iterable
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from pickle import UnpicklingError
from types import ModuleType
from typing import Any

from numba import njit
from numba.core.caching import IndexDataCacheFile


class CacheFile(IndexDataCacheFile):  # type: ignore[misc]  # numba ships no types
    """The stored functions of a kernel, one file for each source and signature, which is written before the index names it."""

    def save(self, key: Any, data: Any) -> None:
        """Stores a function under a key: its signature and the processor. Where it cannot be stored, the next process compiles it again."""
        digest = sha256(repr((self._source_stamp, key)).encode()).hexdigest()[:16]
        name = f"{self._index_name.removesuffix('.nbi')}.{digest}.nbc"
        with suppress(OSError):
            self._save_data(name, data)
            self._save_index(self._load_index() | {key: name})

    def _load_index(self) -> dict[Any, str]:
        """Returns the names of stored functions by key; none if the index is damaged, or names types that an upgrade removed."""
        try:
            index: dict[Any, str] = super()._load_index()
        except (OSError, AttributeError, ImportError, EOFError, UnpicklingError):
            return {}
        return index


def digest_of(modules: Iterable[ModuleType]) -> str:
    """Returns the digest of these modules' sources, in any order."""
    paths = sorted(str(module.__file__) for module in modules)
    return sha256(b"".join(Path(path).read_bytes() for path in paths)).hexdigest()


def compiled_with(*modules: ModuleType, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Returns a decorator like `njit(cache=True, **options)`, whose stored functions are current while `modules` do not change, either.

    `modules`: all modules whose kernels are called, directly or through others.
    """
    digests = (digest_of(modules),) if modules else ()

    def decorate(function: Callable[..., Any]) -> Any:
        kernel = njit(cache=True, **options)(function)
        cache = kernel._cache  # noqa: SLF001  # numba offers nothing public; a test edits a called module
        base, stamp = cache._impl.filename_base, cache._cache_file._source_stamp  # noqa: SLF001  # as above
        cache._cache_file = CacheFile(cache.cache_path, base, (*stamp, *digests))  # noqa: SLF001  # as above
        return kernel

    return decorate
