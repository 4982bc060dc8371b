"""Problems of users: pushed as an archive, listed, shown. Nothing of an archive is run here, and nothing is written to a file."""

from functools import partial
from hashlib import sha256
from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Header, Request, Response
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from drivecal.api.dependencies import ArchivePlace, DatabaseDependency, Limits, LimitsDependency
from drivecal.api.http.authorisation import refuse_push
from drivecal.api.http.bodies import body_of, check_encoding
from drivecal.api.http.queries import ProblemsQuery
from drivecal.api.responses import ROOT, matches
from drivecal.api.results.curves import shapes_of
from drivecal.bundles.archives import content_digest, files_of
from drivecal.bundles.manifest import Manifest
from drivecal.campaigns.cells.earlier import unclaimed
from drivecal.configuration.memory import give_back
from drivecal.configuration.problems import read_archived
from drivecal.configuration.pushing import HEADER
from drivecal.contracts.inventory import ProblemAnswer, ProblemHeading, ProblemPage
from drivecal.storage import admission, bundles
from drivecal.storage.bundles import BundleHeading, StoredBundle
from drivecal.storage.engine.database import Database

PATH = f"{ROOT}/problems"
MEDIA_TYPE = "application/zip"
_ARCHIVE = {"content": {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}}}
_PUSHED: dict[int | str, dict[str, Any]] = {
    200: {"model": ProblemAnswer, "description": "This content is stored already; its name means it now"},
    201: {"model": ProblemAnswer, "description": "It is stored", "headers": {"Location": {"schema": {"type": "string"}}}},
}

router = APIRouter(prefix="/problems", tags=["problems"])


@router.post(
    "", response_model=None, status_code=201, responses=_PUSHED, openapi_extra={"requestBody": _ARCHIVE | {"required": True}}
)
async def push(
    request: Request,
    database: DatabaseDependency,
    limits: LimitsDependency,
    _signature: Annotated[
        str | None, Header(alias=HEADER, description="Without tokens: SHA-256 of the body and its signature, hexadecimal.")
    ] = None,
) -> Response:
    """Stores a problem: a zip archive with `problem.yaml` at its top. Takes a token of the role `author`, or without tokens a signature by
    the secret in the server's home folder; on other addresses than loopback only if `DRIVECAL_ALLOW_PUSH` is true."""
    signed = refuse_push(request)
    check_encoding(request)
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != MEDIA_TYPE:
        raise HTTPException(415, f"the body is not declared as an archive; send Content-Type: {MEDIA_TYPE}")
    with limits.archives.take():
        content = await body_of(request)
        async with limits.large_bodies:
            try:
                stored, new, notes = await to_thread.run_sync(partial(_store, database, limits, content, signed))
            finally:
                await to_thread.run_sync(give_back)
    answer = _answer(stored).model_copy(update={"notes": notes})
    return JSONResponse(answer.model_dump(mode="json"), 201 if new else 200, {"Location": answer.links["self"]})


@router.get("")
def list_problems(query: ProblemsQuery, database: DatabaseDependency) -> ProblemPage:
    """The current problem of each name, last pushed first; with `name` every push of it."""
    page, following = database.query(bundles.listing, name=query.name, limit=query.limit, cursor=query.cursor)
    return ProblemPage(items=[ProblemHeading.of(stored, links=_links(stored)) for stored in page], next_cursor=following)


@router.get("/{problem}")
def read(problem: str, database: DatabaseDependency) -> ProblemAnswer:
    """A problem by its name or digest."""
    return _answer(database.query(bundles.named, problem))


@router.get("/{problem}/archive", response_class=Response, responses={200: _ARCHIVE, 304: {"description": "It is unchanged"}})
def read_archive(
    problem: str, database: DatabaseDependency, _place: ArchivePlace, if_none_match: Annotated[str | None, Header()] = None
) -> Response:
    """The archive of a problem, as it was pushed."""
    with database.read() as connection:
        stored = bundles.named(connection, problem)
        tag = f'"{stored.digest}"'
        if matches(if_none_match, tag):
            return Response(status_code=304, headers={"ETag": tag})
        content = bundles.archive(connection, stored.digest)
    headers = {"ETag": tag, "Content-Disposition": f'attachment; filename="{stored.name}.zip"'}
    return Response(content, headers=headers, media_type=MEDIA_TYPE)


def _store(database: Database, limits: Limits, content: bytes, signed: str | None) -> tuple[StoredBundle, bool, list[str]]:
    """Checks an archive and stores it; returns it, whether it is new, and notes. Raises InvalidInputError for its faults."""
    if signed is not None and sha256(content).hexdigest() != signed:
        raise HTTPException(403, f"the header {HEADER} signs another body")
    files = files_of(content, limits.settings.problem_mb * 2**20)
    manifest, _ = read_archived(files)
    digest = content_digest(content)
    document = manifest.model_dump(mode="json")
    with database.transaction() as connection:
        admission.admit_problem(connection, digest, limits.settings.pushed_problems)
        stored, new = bundles.add(connection, digest=digest, name=manifest.problem, manifest=document, archive=content)
        return stored, new, unclaimed(connection, digest, manifest)


def _answer(stored: StoredBundle) -> ProblemAnswer:
    sections = {name: stored.manifest[name] for name in ProblemAnswer.model_fields if name in stored.manifest}
    manifest = Manifest.model_validate(stored.manifest)
    sections |= {
        "parameters": {name: entry.model_dump(mode="json") for name, entry in manifest.scalars.items()},
        "shapes": shapes_of(manifest),
        "constraints": list(manifest.conditions),
        "baseline": manifest.start,
    }
    return ProblemAnswer.of(stored, links=_links(stored), **sections)


def _links(stored: BundleHeading) -> dict[str, str]:
    here = f"{PATH}/{stored.digest}"
    return {"self": here, "archive": f"{here}/archive"}
