"""The report of a campaign: one page, or all of its files."""

import io
import pickle
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response

from drivecal.api.dependencies import ReportPlace
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import Parameters
from drivecal.api.review.own_client import own_client
from drivecal.api.review.route import HEADERS
from drivecal.domain.errors import OverloadError
from drivecal.report import PAGE
from drivecal.report.whole import Report, read_report

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["results"], route_class=StrictRoute)

SECONDS = 120.0
"""Longest time of drawing; a report of many studies takes ten."""


class ReportOf(Parameters):
    """`format`: one page without links to files, or a ZIP archive of the page, its figures as SVG and PNG, and tables as CSV."""

    format: Literal["html", "zip"] = "html"


ReportQuery = Annotated[ReportOf, Query()]


@router.get(
    "/report",
    response_class=Response,
    responses={
        200: {
            "content": {
                "text/html": {"schema": {"type": "string"}},
                "application/zip": {"schema": {"type": "string", "format": "binary"}},
            },
            "description": "The report",
        }
    },
)
def report(campaign_id: str, query: ReportQuery, request: Request, _: ReportPlace) -> Response:
    """The report of a campaign, which needs no server: question, result, trust, search, reuse, best sets and cost, as
    `drivecal report` writes it. Takes some seconds; two at a time are written."""
    with own_client(request) as client:
        whole = read_report(client, campaign_id)
        tables = {} if query.format == "html" else {name: [b"".join(pieces)] for name, pieces in whole.tables.items()}
    name = f"report-{whole.data.campaign.id}"
    with tempfile.TemporaryDirectory(prefix="drivecal-report-") as folder:
        _write(Report(whole.data, tables), Path(folder), page_alone=query.format == "html")
        if query.format == "html":
            return Response((Path(folder) / PAGE).read_bytes(), headers=HEADERS, media_type="text/html")
        headers = {"Content-Disposition": f'attachment; filename="{name}.zip"', "Cache-Control": "no-cache"}
        return Response(_archive(Path(folder), name), headers=headers, media_type="application/zip")


def _write(whole: Report, folder: Path, *, page_alone: bool) -> None:
    """Writes the files in a process of its own. Raises OverloadError if it takes too long."""
    command = [sys.executable, "-m", "drivecal.report", str(folder)]
    content = pickle.dumps((whole, page_alone))
    try:
        ended = subprocess.run(command, input=content, capture_output=True, timeout=SECONDS, check=False)  # noqa: S603  # ours
    except subprocess.TimeoutExpired as error:
        raise OverloadError(f"the report was not written within {SECONDS:g} s; try again later", 30) from error
    if ended.returncode:
        raise RuntimeError(f"no report: {ended.stderr.decode(errors='replace')[-2000:]}")


def _archive(folder: Path, name: str) -> bytes:
    """Returns the files of a folder as a ZIP archive, in a folder `name`."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.write(path, f"{name}/{path.relative_to(folder).as_posix()}")
    return stream.getvalue()
