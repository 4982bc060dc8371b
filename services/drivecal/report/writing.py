"""Writes a campaign's report."""

import json
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path

from drivecal.report.data import ReportData
from drivecal.report.figure_list import figures
from drivecal.report.folder import writable
from drivecal.report.page import page
from drivecal.report.sections import robustness, savings


def write_report(findings: ReportData, tables: Mapping[str, Iterable[bytes]], folder: Path) -> list[Path]:
    """Writes the page, the figures, the `tables` (CSV by name, in pieces) and the campaign as it was submitted; returns what was written,
    the page last. Raises InvalidInputError if it cannot be written."""
    with writable(folder) as target:
        drawn = {figure.name: target.draw(figure) for figure in figures(findings)}
        for name, pieces in tables.items():
            target.write(f"tables/{name}.csv", pieces)
        if findings.robustness:
            target.table("robustness-boxes", robustness.boxes(findings.robustness[0]))
        if findings.accounting is not None:
            target.table("accounting", savings.by_scenario(findings.accounting))
            target.table("balance", savings.balance(findings.accounting))
        document = json.dumps(findings.campaign.spec, indent=2, ensure_ascii=False)
        target.write("campaign.json", [document.encode() + b"\n"])
        target.write("index.html", [page(findings, drawn, target.files, version("drivecal")).encode()])
    return target.written
