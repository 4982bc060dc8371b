"""Problem bundles on disk: reads a folder with `problem.yaml` into a checked manifest and an archive."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from drivecal.bundles.archives import MANIFEST, BundleFile, executables, files_of, manifest_text, pack, with_files
from drivecal.bundles.checks import checked
from drivecal.bundles.highway import HighwaySimulator
from drivecal.bundles.manifest import Manifest
from drivecal.client.documents import LARGEST_FILE, located_yaml
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem


def read_bundle(folder: str | Path) -> tuple[Manifest, bytes]:
    """Returns the checked manifest and the archive of a folder, which also holds the networks made of its OpenDRIVE files.

    Raises InvalidInputError with the lines of all faults, and UnavailableError if a conversion needs netconvert, which is missing.
    """
    manifest, archive, _ = read_bundle_with_notes(folder)
    return manifest, archive


def read_bundle_with_notes(folder: str | Path) -> tuple[Manifest, bytes, tuple[str, ...]]:
    """Returns manifest and archive as `read_bundle` does, and notes: what is assumed or ignored of its files."""
    path = Path(folder)
    if not (path / MANIFEST).is_file():
        remedy = "drivecal problem init KIND NAME writes one" if path.is_dir() else "give the folder of a problem"
        raise InvalidInputError(Problem(shown(str(path / MANIFEST), 200), "there is no such file", remedy))
    archive = pack(path)
    files = files_of(archive)
    manifest = read_manifest(manifest_text(files), executables(files))
    if not isinstance(manifest.simulator, HighwaySimulator):
        return manifest, archive, ()
    from drivecal.bundles.highway_roads import conversions, scenario_notes

    try:
        networks, notes = conversions(manifest, files)
    except InvalidInputError as error:
        _, lines = located_yaml(manifest_text(files))
        raise InvalidInputError(
            *(replace(problem, field=_located(problem.field, lines)) for problem in error.problems)
        ) from error
    archive = with_files(archive, networks) if networks else archive
    files = files_of(archive)
    return read_archived(files), archive, (*notes, *scenario_notes(manifest, files))


def manifest_of(archive: bytes) -> Manifest:
    """Returns the checked manifest in an archive. Raises InvalidInputError with the lines of all faults."""
    return read_archived(files_of(archive))


def read_archived(files: Mapping[str, BundleFile]) -> Manifest:
    """Returns the manifest among the files of an archive, checked with their content. Raises InvalidInputError as `read_manifest`."""
    return read_manifest(manifest_text(files), executables(files), files)


def read_manifest(
    content: bytes, files: Mapping[str, bool] | None = None, contents: Mapping[str, BundleFile] | None = None
) -> Manifest:
    """Returns the manifest in the text of a `problem.yaml`.

    `files`: whether each file of the bundle is executable, None if unknown; `contents`: the files, if the roads of its scenarios are
    to be checked. Raises InvalidInputError with the lines of all faults.
    """
    if len(content) > LARGEST_FILE:
        raise InvalidInputError(Problem(MANIFEST, f"it is larger than {LARGEST_FILE:,} bytes", "move data into other files"))
    lines: Mapping[str, int] = {}
    try:
        document, lines = located_yaml(content)
        manifest = checked(document, files)
        if contents is not None and isinstance(manifest.simulator, HighwaySimulator):
            from drivecal.bundles.highway_roads import check_roads  # with scipy, for this kind only

            check_roads(manifest, contents)
    except InvalidInputError as error:
        problems = [replace(problem, field=_located(problem.field, lines)) for problem in error.problems]
    else:
        return manifest
    raise InvalidInputError(*problems)


def _located(field: str, lines: Mapping[str, int]) -> str:
    """Returns a field with file and line: its own, or that of the section that lacks it."""
    owner = field
    while owner and owner not in lines:
        owner = re.sub(r"(?:\.?[^.\[]*|\[\d*\]?)$", "", owner)
    line = f"line {lines[owner]}" if owner else ""
    return ": ".join(filter(None, (MANIFEST, line, field)))
