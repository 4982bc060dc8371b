"""Problem bundles on disk: reads a folder with `problem.yaml` into a checked manifest and an archive."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

from drivecal.bundles.archives import MANIFEST, BundleFile, files_of, manifest_text, pack, with_files
from drivecal.bundles.checks import checked, script_problems
from drivecal.bundles.fmus.bundles import check_fmus
from drivecal.bundles.highway import HighwaySimulator
from drivecal.bundles.manifest import Manifest
from drivecal.configuration.documents import LARGEST_FILE, located
from drivecal.configuration.pushing import HEADER, read_secret, sign
from drivecal.configuration.settings import load_settings
from drivecal.contracts.strict_json import shown
from drivecal.contracts.strict_yaml import located_yaml
from drivecal.domain.errors import InvalidInputError, Problem, file_faults, restated

_Checked = TypeVar("_Checked")


def read_bundle(folder: str | Path) -> tuple[Manifest, bytes]:
    """Returns the checked manifest and the archive of a folder, which also holds the networks made of its OpenDRIVE files.

    Raises InvalidInputError with the lines of all faults, and UnavailableError if a conversion needs netconvert, which is missing.
    """
    manifest, archive, _ = read_bundle_with_notes(folder)
    return manifest, archive


def read_bundle_with_notes(folder: str | Path) -> tuple[Manifest, bytes, tuple[str, ...]]:
    """Returns manifest and archive as `read_bundle` does, and notes on units of FMUs and assumptions of road conversions."""
    path = Path(folder)
    if not (path / MANIFEST).is_file():
        remedy = "drivecal problem init KIND NAME writes one" if path.is_dir() else "give the folder of a problem"
        raise InvalidInputError(Problem(shown(str(path / MANIFEST), 200), "there is no such file", remedy))
    archive = pack(path)
    files = files_of(archive)
    manifest, fmu_notes = _read(manifest_text(files), lambda document: _whole_with_fmus(document, files))
    if not isinstance(manifest.simulator, HighwaySimulator):
        return manifest, archive, fmu_notes
    from drivecal.bundles.highway_roads import conversions  # with scipy, for this kind only

    networks, notes = _read(manifest_text(files), lambda _: conversions(manifest, files))
    archive = with_files(archive, networks) if networks else archive
    with restated(lambda problem: _with_notes(problem, notes)):
        manifest, road_notes = read_archived(files_of(archive))
    return manifest, archive, (*fmu_notes, *notes, *road_notes)


def _with_notes(problem: Problem, notes: Sequence[str]) -> Problem:
    """Returns a problem of a place on a road with the first notes on the conversion, which may name its cause."""
    if not notes or not re.search(r"\.(route|ego|traffic)\b", problem.field):
        return problem
    return replace(problem, remedy=f"{problem.remedy}; notes on the roads: {'; '.join(notes[:3])}")


def read_archived(files: Mapping[str, BundleFile]) -> tuple[Manifest, tuple[str, ...]]:
    """Returns the manifest among the files of an archive, checked with their content, and notes on the roads of its scenarios.

    Raises InvalidInputError with the lines of all faults.
    """

    def whole(document: Any) -> tuple[Manifest, tuple[str, ...]]:
        manifest, _ = _whole_with_fmus(document, files)
        if not isinstance(manifest.simulator, HighwaySimulator):
            return manifest, ()
        from drivecal.bundles.highway_roads import check_roads

        return manifest, check_roads(manifest, files)

    return _read(manifest_text(files), whole)


def _whole_with_fmus(document: Any, files: Mapping[str, BundleFile]) -> tuple[Manifest, tuple[str, ...]]:
    manifest = checked(document, files)
    problems = list(script_problems(manifest.simulator, files))
    if problems:
        raise InvalidInputError(*problems)
    return manifest, check_fmus(manifest, files)


def _read(content: bytes, check: Callable[[Any], _Checked]) -> _Checked:
    """Returns the result of `check` for a document. Raises InvalidInputError, with the lines of all faults."""
    if len(content) > LARGEST_FILE:
        raise InvalidInputError(Problem(MANIFEST, f"it is larger than {LARGEST_FILE:,} bytes", "move data into other files"))
    lines: Mapping[str, int] = {}
    with restated(lambda problem: replace(problem, field=located(problem.field, lines, MANIFEST))):
        document, lines = located_yaml(content)
        return check(document)


Pushed = bytes | str | PathLike[str]
"""A problem: its archive, or the path of its folder or of an archive."""


def archive_of(problem: Pushed) -> bytes:
    """Returns the archive of a problem. Raises InvalidInputError with all faults of a folder."""
    if isinstance(problem, bytes):
        return problem
    path = Path(problem)
    if not path.is_file():
        return read_bundle(path)[1]
    with file_faults(path, "read", "give a folder"):
        return path.read_bytes()


def push_headers(archive: bytes, *, signed: bool) -> dict[str, str]:
    """Returns the headers of a push, `signed` by the secret of the server with this home folder if this user can read it."""
    headers = {"Content-Type": "application/zip"}
    secret = read_secret(load_settings().home) if signed else None
    return headers if secret is None else headers | {HEADER: sign(secret, archive)}
