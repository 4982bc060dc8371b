"""Reports: the page of the server in one file, with what the server had answered about a campaign. The page asks the file in the place of
the server (`services/web/src/lib/server/api.svelte.ts`)."""

import json
import re
from collections.abc import Callable, Iterator
from urllib.parse import quote, urlencode

from drivecal.contracts.campaign import Campaign
from drivecal.domain.errors import ConflictError

ROOT = "/api/v1"
READER = {"name": None, "may_write": False}
"""The session of a reader of the file."""
MOST = 1000
"""Rows of a page of an answer."""
_SCRIPT = re.compile(r'<script type="module"[^>]* src="([^"]+)"></script>')
_STYLES = re.compile(r'<link rel="stylesheet"[^>]* href="([^"]+)">')
_ENDING = re.compile(r"</(?=script)|<!--", re.IGNORECASE)
"""Text in a script that would end an element of the page."""
_ICON = re.compile(r'<link rel="icon"[^>]*>')
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "base-uri 'none'; form-action 'none'"
)
"""Policy of the file: it asks nothing of anybody."""


def report_of(ask: Callable[[str], str], campaign: Campaign) -> bytes:
    """Returns the page with a campaign's answers; `ask` returns the text at a path of the server.

    Raises ConflictError for a single evaluation, and if the server has no page.
    """
    if campaign.kind == "evaluation":
        raise ConflictError(f"{campaign.id} is a single evaluation, which has no report; `drivecal show` prints it")
    page = ask("/")
    script, styles = _SCRIPT.search(page), _STYLES.search(page)
    if script is None or styles is None:
        raise ConflictError("the server was installed without its page, which a report consists of")
    answers = {"/session": json.dumps(READER)}
    for path in _asked(campaign, answers):
        answers[path] = ask(ROOT + path)
    code, style = ask(script[1]), ask(styles[1])
    code = _ENDING.sub(lambda match: match[0].replace("<", "\\x3c"), code)
    known = json.dumps(answers, ensure_ascii=False).replace("<", "\\u003c")
    start = json.dumps(f"#/campaigns/{campaign.id}")
    body = (
        f'<script type="application/json" id="answers">{known}</script>\n<script>if (!location.hash) location.hash = {start};</script>\n'
        f'<script type="module">{code}</script>\n</body>'
    )
    page = page.replace(script[0], f'<meta http-equiv="Content-Security-Policy" content="{POLICY}" />')
    page = page.replace(styles[0], f"<style>{style}</style>").replace("</body>", body)
    return _ICON.sub("", page).encode()


def _asked(campaign: Campaign, answers: dict[str, str]) -> Iterator[str]:
    """Yields the paths that the views of a campaign ask for, with queries as the page writes them. `answers`: the replies so far."""
    here = f"/campaigns/{campaign.id}"
    yield here
    yield f"{here}/results"
    if campaign.started_at is not None:
        yield f"{here}/setup"
    yield f"/problems/{quote(str(campaign.spec['problem']), safe='')}"
    yield f"{here}/studies"
    yield from _pages(f"{here}/influence", answers)
    for study in json.loads(answers[f"{here}/studies"])["items"]:
        yield from _pages(f"/campaigns/{study['campaign']}/{study['stage']}", answers)
    if campaign.spec.get("optimizer", {}) is None:
        return
    yield from _pages(f"{here}/generations", answers)
    yield f"{here}/solutions?format=csv"
    yield f"{here}/importance"
    if len(campaign.spec.get("objectives") or ()) > 1 and campaign.best is not None:
        yield f"{here}/front/summary"
        yield f"{here}/front/evaluated?format=csv"
        yield from _pages(f"{here}/front", answers)


def _pages(path: str, answers: dict[str, str]) -> Iterator[str]:
    """Yields the path of each page of a list."""
    query: dict[str, str | int] = {"limit": MOST}
    while query.get("cursor", "") is not None:
        page = f"{path}?{urlencode(query)}"
        yield page
        query["cursor"] = json.loads(answers[page])["next_cursor"]
