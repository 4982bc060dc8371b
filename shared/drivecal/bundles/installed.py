"""Problems that installed packages bring, behind the entry point group `drivecal.problems`: folders as `problem push` takes them.

The built-in motorway, `highway`, is one of them.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

from drivecal.bundles.archives import MANIFEST, content_digest, files_digest, files_of, pack
from drivecal.bundles.checks import checked
from drivecal.bundles.fmus.bundles import check_fmus
from drivecal.bundles.manifest import Manifest
from drivecal.contracts.strict_yaml import located_yaml
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.plugins import registry

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Bundle:
    """A problem: its manifest, and what names its files."""

    digest: str
    """Digest of the content."""
    files: str
    """Digest of every file except `problem.yaml`."""
    manifest: Manifest
    tools: str | None = None
    """Answer of its `probe` on the workers; None before a worker was asked and without a probe."""


@dataclass(frozen=True)
class InstalledProblem(Bundle):
    """A problem of an installed package."""

    folder: Path = Path()

    @cached_property
    def archive(self) -> bytes:
        """The folder as an archive."""
        return pack(self.folder)


def read(name: str, folder: Path) -> InstalledProblem:
    """Returns the problem in an installed folder. Raises InvalidInputError with its faults, and if it has another name."""
    archive = pack(folder)
    files = files_of(archive)
    document, _ = located_yaml(files[MANIFEST].content)
    manifest = checked(document, files, taken=())
    if manifest.problem != name:
        raise InvalidInputError(Problem("problem", f"{manifest.problem} is registered as {name}", "register it by its name"))
    check_fmus(manifest, files)
    return InstalledProblem(content_digest(archive), files_digest(archive), manifest, folder=folder)


@cache
def installed_problems() -> Mapping[str, InstalledProblem]:
    """Returns the installed problems by name. A faulty one is left out, with its faults in the log."""
    problems = {}
    for name, folder in registry.problems().items():
        try:
            problems[name] = read(name, folder)
        except (InvalidInputError, OSError) as error:
            log.warning("the installed problem %s cannot be used: %s", name, error)
    return problems


def installed(name_or_digest: str) -> InstalledProblem | None:
    """Returns an installed problem by its name or digest, None without one."""
    problems = installed_problems()
    by_digest = {problem.digest: problem for problem in problems.values()}
    return problems.get(name_or_digest) or by_digest.get(name_or_digest)
