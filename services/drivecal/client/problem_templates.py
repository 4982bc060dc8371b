"""Writes new problems: a folder with a `problem.yaml` and a simulation that works, to be edited."""

import re
from importlib import resources
from pathlib import Path

from drivecal.bundles.archives import MANIFEST, files_of
from drivecal.bundles.checks import checked
from drivecal.bundles.installed import installed_problems
from drivecal.contracts.strict_json import shown
from drivecal.contracts.strict_yaml import located_yaml
from drivecal.domain.errors import InvalidInputError, Problem, file_faults

PLANNER = "highway-planner"
"""The built-in motorway as a start."""
KINDS = ("process", "command", "python", "python-random", "fmu", "highway", PLANNER)
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]{0,63}")


def write_problem(kind: str, name: str, folder: str | Path | None = None) -> list[Path]:
    """Writes a new problem into `folder`, by default one of its name, and returns its files. Raises InvalidInputError."""
    path = Path(name if folder is None else folder)
    _check(kind, name, path)
    contents = _template(kind, name)
    contents[MANIFEST] = contents[MANIFEST].replace("NAME", name).replace("FOLDER", path.name)
    checked(located_yaml(contents[MANIFEST].encode())[0])
    with file_faults(shown(str(path), 200), "written", "give another folder"):
        path.mkdir(parents=True, exist_ok=True)
        for inner, content in contents.items():
            (path / inner).write_text(content, encoding="utf-8")
    return sorted(path.iterdir())


def _template(kind: str, name: str) -> dict[str, str]:
    if kind != PLANNER:
        folder = resources.files("drivecal.client") / "templates" / kind
        return {file.name.removesuffix(".txt"): file.read_text(encoding="utf-8") for file in folder.iterdir() if file.is_file()}
    files = {name: file.content.decode() for name, file in files_of(installed_problems()["highway"].archive).items()}
    _, _, sections = files[MANIFEST].partition("\n\n")
    return files | {MANIFEST: f"problem: {name}\ndescription: The planner of drivecal on six roads of a motorway\n\n{sections}"}


def _check(kind: str, name: str, path: Path) -> None:
    if kind not in KINDS:
        raise InvalidInputError(Problem("kind", f"{shown(kind)} is not one of the kinds", f"give {', '.join(KINDS)}"))
    if not _NAME.fullmatch(name):
        remedy = "start with a letter; go on with letters, digits, `_`, `.` or `-`"
        raise InvalidInputError(Problem("name", f"'{shown(name)}' is not a valid name", remedy))
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InvalidInputError(Problem(shown(str(path), 200), "it exists already", "give another name, or remove it"))
