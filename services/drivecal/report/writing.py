"""Writes a report to a folder."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.metadata import version
from pathlib import Path

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.report import accounts
from drivecal.report.drawing import inlined, png, svg
from drivecal.report.figures import figures
from drivecal.report.findings import Findings
from drivecal.report.page import page


def write_report(findings: Findings, tables: Mapping[str, Iterable[bytes]], folder: Path) -> list[Path]:
    """Writes the page, the figures, the `tables` (CSV by name, in pieces) and the campaign as it was submitted; returns what was written.

    Files of an earlier report in the same folder are replaced, the page last. Raises InvalidInputError where it cannot be written.
    """
    written: list[Path] = []

    def write(name: str, pieces: Iterable[bytes]) -> None:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as stream:
            for piece in pieces:
                stream.write(piece)
        written.append(path)

    try:
        in_page: list[tuple[str, str, str]] = []
        for drawn in figures(findings):
            document = svg(drawn.figure, drawn.name)
            write(f"figures/{drawn.name}.svg", [document.encode()])
            write(f"figures/{drawn.name}.png", [png(drawn.figure)])
            if drawn.in_page:
                in_page.append((drawn.name, drawn.caption, inlined(document, drawn.name, escape(drawn.caption))))
        for name, pieces in tables.items():
            write(f"tables/{name}.csv", pieces)
        if findings.accounting is not None:
            write("tables/accounting.csv", [_csv(accounts.by_scenario(findings.accounting))])
            write("tables/balance.csv", [_csv(accounts.balance(findings.accounting))])
        write("campaign.json", [json.dumps(findings.campaign.spec, indent=2, ensure_ascii=False).encode() + b"\n"])
        files = [path.relative_to(folder).as_posix() for path in written]
        write("index.html", [page(findings, in_page, files, version("drivecal")).encode()])
    except OSError as error:
        where = str(error.filename or folder)
        raise InvalidInputError(Problem(where, f"it cannot be written: {error.strerror}", "give another folder")) from error
    return written


def _csv(rows: Iterable[Sequence[object]]) -> bytes:
    stream = io.StringIO()
    csv.writer(stream).writerows(rows)
    return stream.getvalue().encode()
