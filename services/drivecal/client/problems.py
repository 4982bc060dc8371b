"""Problem bundles on disk: reads a folder with `problem.yaml` into a checked manifest and an archive."""

import re
from collections.abc import Mapping
from pathlib import Path

from drivecal.bundles.archives import MANIFEST, executables, files_of, manifest_text, pack
from drivecal.bundles.checks import checked
from drivecal.bundles.manifest import Manifest
from drivecal.client.documents import LARGEST_FILE, located_yaml
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem


def read_bundle(folder: str | Path) -> tuple[Manifest, bytes]:
    """Returns the checked manifest and the archive of a folder. Raises InvalidInputError with the lines of all faults."""
    path = Path(folder)
    if not (path / MANIFEST).is_file():
        remedy = "drivecal problem init KIND NAME writes one" if path.is_dir() else "give the folder of a problem"
        raise InvalidInputError(Problem(shown(str(path / MANIFEST), 200), "there is no such file", remedy))
    archive = pack(path)
    return manifest_of(archive), archive


def manifest_of(archive: bytes) -> Manifest:
    """Returns the checked manifest in an archive. Raises InvalidInputError with the lines of all faults."""
    files = files_of(archive)
    return read_manifest(manifest_text(files), executables(files))


def read_manifest(content: bytes, files: Mapping[str, bool] | None = None) -> Manifest:
    """Returns the manifest in the text of a `problem.yaml`. `files`: whether each file of the bundle is executable, None if unknown.

    Raises InvalidInputError with the lines of all faults.
    """
    if len(content) > LARGEST_FILE:
        raise InvalidInputError(Problem(MANIFEST, f"it is larger than {LARGEST_FILE:,} bytes", "move data into other files"))
    lines: Mapping[str, int] = {}
    try:
        document, lines = located_yaml(content)
        return checked(document, files)
    except InvalidInputError as error:
        problems = [Problem(_located(problem.field, lines), problem.message, problem.remedy) for problem in error.problems]
    raise InvalidInputError(*problems)


def _located(field: str, lines: Mapping[str, int]) -> str:
    """Returns a field with file and line: its own, or that of the section that lacks it."""
    owner = field
    while owner and owner not in lines:
        owner = re.sub(r"(?:\.?[^.\[]*|\[\d*\]?)$", "", owner)
    line = f"line {lines[owner]}" if owner else ""
    return ": ".join(filter(None, (MANIFEST, line, field)))
