"""Runs the notebooks of docs/pages/notebooks in a Jupyter kernel and stores their outputs; a test runs them anew and compares.

python docs/notebooks.py     # starts a server of its own, as `drivecal demo` does
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import nbformat
from nbclient import NotebookClient

from drivecal.cli.commands.demo import coordinator

NOTEBOOKS = sorted((Path(__file__).parent / "pages" / "notebooks").glob("*.ipynb"))
SECONDS = 600
"""Longest time of a cell; busy machines are slow."""
_ID = re.compile(r"\b[0-9a-f]{32}\b")


def stored(path: Path) -> Any:
    """Returns a notebook as it is in its file."""
    return nbformat.read(path, as_version=4)  # type: ignore[no-untyped-call]  # not all of nbformat has types


def executed(path: Path, folder: Path) -> Any:
    """Returns a notebook with the outputs that its cells have now, run in `folder`. Raises CellExecutionError if a cell fails."""
    notebook = stored(path)
    NotebookClient(notebook, timeout=SECONDS, kernel_name="python3", resources={"metadata": {"path": str(folder)}}).execute()
    for cell in notebook.cells:
        cell.metadata.clear()  # times of its run
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
            for output in cell.outputs:
                output.pop("transient", None)
                if {"text/html", "image/png"} & set(output.get("data", ())):
                    output["data"].pop("text/plain", None)  # names objects by their address, and counts milliseconds
    notebook.metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    return notebook


def shown(notebook: Any) -> list[list[dict[str, str]]]:
    """Returns the outputs of each code cell, without ids; images count, their content does not."""
    cells = [cell.outputs for cell in notebook.cells if cell.cell_type == "code"]
    return [[_comparable(output) for output in outputs] for outputs in cells]


def _comparable(output: Any) -> dict[str, str]:
    data = {"text/plain": output["text"]} if output.output_type == "stream" else output["data"]
    return {kind: _ID.sub("ID", content) if kind.startswith("text/") else "" for kind, content in data.items()}


def main() -> None:
    """Runs all notebooks and stores their outputs."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "home").mkdir()
        os.environ |= {"DRIVECAL_BACKEND": "processes", "DRIVECAL_HOME": str(folder / "home")}
        with coordinator(folder / "home") as client:
            os.environ["DRIVECAL_URL"] = client.url
            for path in NOTEBOOKS:
                (folder / path.stem).mkdir()
                notebook = executed(path, folder / path.stem)
                nbformat.write(notebook, path)  # type: ignore[no-untyped-call]  # not all of nbformat has types
                print(f"{path.name}: its outputs are stored")


if __name__ == "__main__":
    main()
