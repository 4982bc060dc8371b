"""Simulator kind `python`: a function in a file, in an interpreter of its own. The child speaks the protocol of kind `process`."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivecal.adapters.children import Launch
from drivecal.adapters.process import ProcessSession
from drivecal.adapters.scratch import Scratch
from drivecal.plugins.simulators import VERSIONS, Declared, UnsuitableError


class PythonAdapter:
    """Simulator kind `python`."""

    version = VERSIONS["python"]

    def open(
        self, section: Mapping[str, Any], scenario: str, data: Mapping[str, Any], folder: Path, declared: Declared
    ) -> ProcessSession:
        """Starts the interpreter and imports the function."""
        folder = folder.resolve()
        wheels = section.get("wheels")
        for name in (section["file"], *([] if wheels is None else [wheels])):
            if not (folder / name).exists():
                raise UnsuitableError(f"{name} does not exist in the bundle")
        scratch = Scratch(folder)
        settings = {
            "file": str(folder / section["file"]),
            "function": section.get("function", "evaluate"),
            "wheels": None if wheels is None else str(folder / wheels),
            "packages": str(scratch.folder / "packages"),
        }
        launch = Launch.of(driver_command("python_driver", settings), section)
        return ProcessSession(
            launch, scratch, declared, timeout=section["timeout"], scenario=scenario, data=data, blames_files=True
        )


def driver_command(module: str, settings: Mapping[str, Any]) -> list[str]:
    """Returns the command of one of drivecal's own drivers: without environment variables and user packages, and without writing bytecode
    beside the bundle's files."""
    return [sys.executable, "-I", "-B", "-m", f"drivecal.adapters.{module}", json.dumps(settings)]
