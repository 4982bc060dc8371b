"""The page and the documentation: files as the build made them, under a policy that lets them speak to this server only."""

import gzip
import html
from collections.abc import Mapping
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

from fastapi import APIRouter, Request, Response
from fastapi.responses import RedirectResponse
from starlette.exceptions import HTTPException

from drivecal.api.http.authorisation import HELP, PAGE
from drivecal.api.responses import matches, takes_gzip

router = APIRouter(include_in_schema=False)

FILES = Path(__file__).parent.parent / "static"
"""Folder of the built page (services/web/build_hook.py)."""
MANUAL = FILES.parent / "help"
"""Folder of the built documentation (docs/build.py)."""
START = "index.html"
DOCS = "docs.html"
REASON = "missing.txt"
"""File with the reason for a missing page."""
TYPES = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".ipynb": "application/x-ipynb+json",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".png": "image/png",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
    ".webp": "image/webp",
}
POLICY = (
    "default-src 'none'; script-src 'self'; worker-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
GUARD = {
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
MANUAL_GUARD = GUARD | {"Content-Security-Policy": POLICY.replace("style-src 'self'", "style-src 'self' 'unsafe-inline'")}
"""The search of the documentation's theme brings its styles by script. Scripts have to be files there as well."""
FOREVER = "public, max-age=31536000, immutable"
"""`Cache-Control` of files whose names change with their content."""


@router.get("/")
def start(request: Request) -> Response:
    """The page; if it was not built, a plain one with the reason and the alternatives."""
    return _answer(request, FILES / START, "no-cache") if (FILES / START).is_file() else _instead(FILES)


@router.get("/docs")
def docs(request: Request) -> Response:
    """The documentation of the API, which asks no other host."""
    return _answer(request, FILES / DOCS, "no-cache") if (FILES / DOCS).is_file() else _instead(FILES)


@router.get(HELP)
def manual() -> RedirectResponse:
    """The documentation's address with the slash that its relative links need."""
    return RedirectResponse(HELP + "/", 308)


@router.get(HELP + "/{name:path}")
def manual_page(name: str, request: Request) -> Response:
    """A page or file of the documentation."""
    if not (MANUAL / START).is_file():
        return _instead(MANUAL)
    if not _holds(MANUAL, name or START):
        raise HTTPException(404, f"the documentation has no such page; it starts at {HELP}/")
    return _answer(request, MANUAL / (name or START), "no-cache", MANUAL_GUARD)


@router.get(PAGE + "{name:path}")
def file(name: str, request: Request) -> Response:
    """A file of the page."""
    if not _holds(FILES, name):
        raise HTTPException(404, "the page has no such file; the page may have changed since: load it again")
    return _answer(request, FILES / name, FOREVER if name.startswith("assets/") else "no-cache")


def _holds(folder: Path, name: str) -> bool:
    """Returns whether a folder has a file of this name to serve. A file has a single name: `..` would make others of it."""
    if ".." in Path(name).parts:
        return False
    try:
        path = (folder / name).resolve()
        return path.suffix in TYPES and path.is_relative_to(folder.resolve()) and path.is_file()
    except (OSError, ValueError):  # too long, or with a null character
        return False


def _answer(request: Request, path: Path, caching: str, guard: Mapping[str, str] = GUARD) -> Response:
    content, compressed, tag = _read(path, path.stat().st_mtime_ns)
    headers = {**guard, "Cache-Control": caching, "ETag": tag, "Vary": "Accept-Encoding"}
    if matches(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers=headers)
    if takes_gzip(request.headers.get("accept-encoding", "")) and len(compressed) < len(content):
        content, headers["Content-Encoding"] = compressed, "gzip"
    headers["Content-Type"] = TYPES[path.suffix]
    return Response(content, headers=headers)


@lru_cache(maxsize=500)
def _read(path: Path, _modified: int) -> tuple[bytes, bytes, str]:
    """Returns the content of a file, the same compressed, and its tag. `_modified`: distinguishes the files of a new build."""
    content = path.read_bytes()
    return content, gzip.compress(content, mtime=0), f'"{sha256(content).hexdigest()[:32]}"'


def _instead(folder: Path) -> Response:
    try:
        reason = (folder / REASON).read_text(encoding="utf-8").strip()
    except OSError:
        reason = "it was not built when drivecal was installed"
    content = (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>drivecal</title>'
        f"<h1>drivecal</h1><p>The server works, but its {'page' if folder == FILES else 'documentation'} is not there: "
        f"{html.escape(reason)}.</p><p>Everything else works: see <code>drivecal --help</code> "
        'and <a href="/openapi.json">the API</a>. Installing drivecal again builds both.</p></html>'
    )
    return Response(content, 200, headers=GUARD | {"Cache-Control": "no-store"}, media_type="text/html")
