"""The content of a review sheet: its digest, and the differences of two sheets.

The digest is SHA-256 of the whole file, in UTF-8, with a zero for each digit of the digest itself. It identifies a content and proves
no author: who changes a number can compute another digest. So it is compared with what was signed, and with the campaign.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from html.parser import HTMLParser
from urllib.parse import parse_qsl, urlsplit

from drivecal.domain.errors import InvalidInputError, Problem

UNSEALED = "0" * 64
"""Place of the digest."""
_DIGEST = re.compile(r'<meta name="drivecal-digest" content="([0-9a-f]{64})">')
_QUERY = re.compile(r'<meta name="drivecal-review" content="([^"<>]{1,500})">')
_VERSION = re.compile(r'<meta name="drivecal-version" content="([^"<>]{1,100})">')
_PLACE = re.compile(r"/campaigns/([0-9A-Za-z-]{1,64})/review")
_DRAWING = re.compile(r"<svg.*?</svg>", re.DOTALL)
_BLOCKS = ("h1", "h2", "h3", "p", "li", "caption", "figcaption", "td", "th", "pre", "title", "style")


@dataclass(frozen=True, slots=True)
class Sheet:
    """A sheet that was written: the campaign and the query that it answers, the version that wrote it, the digest that it names."""

    campaign: str
    query: dict[str, str]
    version: str
    digest: str
    is_unchanged: bool
    """Its content has this digest."""


@dataclass(frozen=True, slots=True)
class ChangedEntry:
    """An entry that differs: its place in words, and its text in two sheets, empty where it is missing."""

    place: str
    first: str
    second: str


def digest_of(text: str) -> str:
    """Returns the digest of a sheet without one."""
    return sha256(text.encode()).hexdigest()


def sealed(text: str) -> str:
    """Returns a sheet with the digest in its places."""
    return text.replace(UNSEALED, digest_of(text))


def digest_in(text: str) -> str:
    """Returns the digest that a sheet names, empty without one."""
    known = _DIGEST.search(text)
    return "" if known is None else known[1]


def read_sheet(text: str, name: str) -> Sheet:
    """Returns what a sheet says of itself. Raises InvalidInputError naming the file if it is no sheet."""
    digest, query, version = (pattern.search(text) for pattern in (_DIGEST, _QUERY, _VERSION))
    if digest is None or query is None or version is None:
        raise InvalidInputError(Problem(name, "it is no review sheet", "give a file that `drivecal review ID -o FILE` wrote"))
    address = urlsplit(query[1].replace("&amp;", "&"))
    place = _PLACE.fullmatch(address.path)
    if place is None:
        raise InvalidInputError(Problem(name, "it names no campaign", "write it again with `drivecal review ID -o FILE`"))
    same = digest_of(text.replace(digest[1], UNSEALED)) == digest[1]
    return Sheet(place[1], dict(parse_qsl(address.query)), version[1], digest[1], same)


def differences(first: str, second: str) -> Iterator[ChangedEntry]:
    """Yields the differing entries of two sheets in their order, without the digests."""
    ours, theirs = (dict(_entries(text)) for text in (first, second))
    for place in dict.fromkeys([*ours, *theirs]):
        texts = ours.get(place, ""), theirs.get(place, "")
        if texts[0] != texts[1]:
            yield ChangedEntry(place, *texts)


def _entries(text: str) -> Iterator[tuple[str, str]]:
    """Yields place and text of all that a sheet shows. A place holds the section, and in a table the caption, the row and the column."""
    digest = _DIGEST.search(text)
    content = text if digest is None else text.replace(digest[1], UNSEALED)
    reader = _Reader()
    reader.feed(_DRAWING.sub("", content))
    reader.close()
    seen: dict[str, int] = {}
    for place, entry in [*reader.entries, *(("drawing", drawing) for drawing in _DRAWING.findall(content))]:
        seen[place] = seen.get(place, 0) + 1
        yield f"{place} ({seen[place]})" if seen[place] > 1 else place, entry


class _Reader(HTMLParser):
    """Collects the entries of a sheet without drawings."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.entries: list[tuple[str, str]] = []
        self._section = "page"
        self._header: list[str] = []
        self._row: list[str] = []
        self._text: list[str] | None = None

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Opens an entry."""
        del attrs
        if tag == "table":
            self._header = []
        elif tag == "tr":
            self._row = []
        elif tag in _BLOCKS:
            self._text = []

    def handle_data(self, data: str) -> None:
        """Reads text."""
        if self._text is not None:
            self._text.append(data)
        elif data.strip():
            self.entries.append((f"{self._section}: text", data.strip()))

    def handle_endtag(self, tag: str) -> None:
        """Closes an entry."""
        if self._text is None or tag not in _BLOCKS:
            return
        text, self._text = " ".join("".join(self._text).split()), None
        place = f"{self._section}: {tag}"
        if tag in {"h1", "h2", "h3"}:
            self._section, place = text, "heading"
        elif tag == "th":
            self._header.append(text)
        elif tag == "td":
            column = self._header[len(self._row)] if len(self._row) < len(self._header) else ""
            self._row.append(text)
            place = ", ".join(word for word in (self._section, self._row[0], column) if word) if len(self._row) > 1 else place
        self.entries.append((place, text))
