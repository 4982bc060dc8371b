"""Builds the documentation as a site, which drivecal serves under /help. The wheel's build hook and `make check` run it.

The site has the pages of docs/pages and the documents of other folders that are listed here. A link to a file without a page becomes plain
text. Zensical refuses broken links and anchors. The site asks no other host and holds no inline script, so that it works offline under a
strict content security policy.

python docs/build.py            # builds it if its sources changed
python docs/build.py check      # builds it in a scratch folder
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from base64 import b64decode
from collections.abc import Callable
from functools import partial
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

DOCS = Path(__file__).parent
ROOT = DOCS.parent
TARGET = ROOT / "services" / "drivecal" / "api" / "help"
REASON, STAMP = "missing.txt", "sources.sha256"
FURTHER = (
    "CHANGELOG.md", "deploy/README.md", "deploy/examples/problems/README.md", "services/README.md", "services/web/README.md",
    "shared/README.md", "shared/decisions/*.md", "shared/drivecal/bundles/highway.md", "shared/drivecal/roads/roads.md",
    "tests/README.md", "workers/README.md", "workers/drivecal/**/*.md",
)  # fmt: skip
"""Documents outside of docs/pages that are pages of the site as well."""
INCLUDED = ("services/web/public/icon.svg",)
"""Further files that the site is made of."""
DECISIONS = "shared/decisions"
SEARCHED = ("docs/pages/", "shared/drivecal/", "deploy/examples/")
"""The search of the site finds the documents for users. Decisions, changes and notes on the code would fill its first hits."""
UNSEARCHED = "---\nsearch:\n  exclude: true\n---\n"
SECONDS = 180
_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
_FENCED = re.compile(r"(^```.*?^```|`[^`\n]+`)", re.MULTILINE | re.DOTALL)
_SMALL_WORDS = (
    "a an and are as at be by can could do does for from get give given handle has have how i if in into is it its may me must my need "
    "of on only or our should that the their them there this to us use was we what when where who will with would you your"
)
_SEARCH = (
    (
        re.compile(r'(\w+)\((\w+),"and",(\w+)=>\('),
        rf'\1(\2,self.anyWord?"or":"and",\3=>" {_SMALL_WORDS} ".includes(` ${{\3.value.toLowerCase()}} `)?void 0:(',
    ),
    (
        re.compile(r'let (\w+)=(\w+)\(\{type:"text",data:(\w+\.data)\}\)'),
        (
            r'self.anyWord=!1;let \1=\2({type:"text",data:{...\3}});'
            r'if(!\1.data.items.length){self.anyWord=!0;\1=\2({type:"text",data:\3})}'
        ),
    ),
)
"""In the search of the theme, the place that demands every typed word and the place that answers, each with what replaces it."""
_INLINE = re.compile(r"<script>(.*?)</script>", re.DOTALL)


class DocumentationError(Exception):
    """Why the documentation cannot be built."""


def sources() -> dict[str, Path]:
    """Returns the files of the site by their place in it."""
    own = {path.relative_to(DOCS / "pages").as_posix(): path for path in (DOCS / "pages").rglob("*") if path.is_file()}
    others = {path.relative_to(ROOT).as_posix(): path for pattern in FURTHER for path in ROOT.glob(pattern)}
    return dict(sorted((own | others).items()))


def linked(text: str, page: Path, place: str, places: dict[Path, str]) -> str:
    """Returns a page with links between its files turned into links between pages. Raises DocumentationError for a missing file."""

    def link(match: re.Match[str]) -> str:
        image, words, address = match.groups()
        path, hash_, anchor = address.partition("#")
        if not path or re.match(r"[a-z]+:", path):
            return match[0]
        file = (page.parent / path).resolve()
        if not file.exists():
            raise DocumentationError(f"{page.relative_to(ROOT)}: {address} names no file")
        target = "decisions.md" if file == ROOT / DECISIONS else places.get(file)
        if target is None:
            return words
        return f"{image}[{words}]({os.path.relpath(target, Path(place).parent).replace(os.sep, '/')}{hash_}{anchor})"

    parts = _FENCED.split(text)
    return "".join(part if index % 2 else _LINK.sub(link, part) for index, part in enumerate(parts))


def decisions() -> str:
    """Returns the list of the decision records."""
    lines = []
    for path in sorted((ROOT / DECISIONS).glob("*.md")):
        title = path.read_text(encoding="utf-8").splitlines()[0].lstrip("# ")
        number, _, words = title.partition(" ")
        lines.append(f"| [{number.rstrip(':')}]({DECISIONS}/{path.name}) | {words} |")
    return "# Decisions\n\nWhy things are as they are, one page each.\n\n| | decision |\n|---|---|\n" + "\n".join(lines) + "\n"


def notebook_page(path: Path, folder: Path, link: Callable[[str], str]) -> str:
    """Returns a notebook as a page with the outputs that it stores; its images are written into `folder`. `link`: see `linked`."""
    parts = []
    for number, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"]):
        text = "".join(cell["source"])
        parts.append(link(text) if cell["cell_type"] == "markdown" else fenced("python", text))
        for place, output in enumerate(cell.get("outputs", ())):
            data = {kind: "".join(content) for kind, content in output.get("data", {}).items()}
            if "image/png" in data:
                image = f"{path.stem}-{number}-{place}.png"
                (folder / image).write_bytes(b64decode(data["image/png"]))
                parts.append(f"![Output of the cell above]({image})")
            elif "text/html" in data:
                parts.append(data["text/html"])
            else:
                parts.append(fenced("text", data.get("text/plain") or "".join(output.get("text", ""))))
    return "\n\n".join(parts) + "\n"


def fenced(language: str, text: str) -> str:
    """Returns a block of code; the file that a cell writes is its title."""
    file = re.match(r"%%writefile (\S+)\n", text)
    title = f' title="{file[1]}"' if file else ""
    name = {".yaml": "yaml"}.get(Path(file[1]).suffix, language) if file else language
    return f"```{name}{title}\n{text[file.end() if file else 0 :].rstrip()}\n```"


def stage(folder: Path) -> None:
    """Writes everything that Zensical reads into `folder`."""
    pages = sources()
    places = {path.resolve(): re.sub(r"\.ipynb$", ".md", place) for place, path in pages.items()}
    for place, path in pages.items():
        target = folder / "pages" / place
        target.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".md":
            searched = path.relative_to(ROOT).as_posix().startswith(SEARCHED)
            text = linked(path.read_text(encoding="utf-8"), path, place, places)
            target.write_text(text if searched else UNSEARCHED + text, encoding="utf-8")
            continue
        shutil.copyfile(path, target)
        if path.suffix == ".ipynb":
            text = notebook_page(path, target.parent, partial(linked, page=path, place=place, places=places))
            target.with_suffix(".md").write_text(f"{text}\n[Download this notebook]({path.name})\n", encoding="utf-8")
    (folder / "pages" / "decisions.md").write_text(UNSEARCHED + decisions(), encoding="utf-8")
    shutil.copyfile(ROOT / "services" / "web" / "public" / "icon.svg", folder / "pages" / "icon.svg")
    shutil.copyfile(DOCS / "zensical.toml", folder / "zensical.toml")


def without_inline_scripts(site: Path) -> None:
    """Moves inline scripts into files, because the server's policy allows none."""
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        base = os.path.relpath(site, page.parent).replace(os.sep, "/")

        def moved(match: re.Match[str], base: str = base) -> str:
            name = f"assets/inline-{sha256(match[1].encode()).hexdigest()[:12]}.js"
            (site / name).write_text(match[1], encoding="utf-8")
            return f'<script src="{base}/{name}"></script>'

        page.write_text(_INLINE.sub(moved, text), encoding="utf-8")


def searching_by_any_word(site: Path) -> None:
    """Lets the search find sections with some of the typed words if none has all, those with most of them first: a question in a reader's
    own words. Words of no meaning, such as "how", do not count. Raises DocumentationError."""
    (script,) = site.glob("assets/javascripts/workers/search.*.js")
    text = script.read_text(encoding="utf-8")
    for pattern, instead in _SEARCH:
        text, count = pattern.subn(instead, text)
        if count != 1:
            raise DocumentationError(f"{script.name} has {count} times {pattern.pattern}; zensical 0.0.73 has it once")
    script.write_text(text, encoding="utf-8")


def build_into(target: Path) -> None:
    """Builds the site into `target`, which it replaces. Raises DocumentationError."""
    if find_spec("zensical") is None:
        raise DocumentationError("zensical is not installed; type: pip install zensical")
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        stage(folder)
        command = [sys.executable, "-m", "zensical", "build", "--strict", "--config-file", str(folder / "zensical.toml")]
        environment = os.environ | {"NO_COLOR": "1"}
        try:
            ran = subprocess.run(
                command, cwd=folder, env=environment, capture_output=True, text=True, timeout=SECONDS, check=False
            )
        except subprocess.TimeoutExpired:
            raise DocumentationError(f"zensical took longer than {SECONDS} s") from None
        if ran.returncode:
            said = re.sub(r"\x1b\[[0-9;]*m", "", ran.stdout + ran.stderr)
            raise DocumentationError(said.partition("Traceback")[0].strip())
        without_inline_scripts(folder / "site")
        searching_by_any_word(folder / "site")
        (folder / "site" / "sitemap.xml").unlink(missing_ok=True)
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(folder / "site", target)


def digest() -> str:
    """Returns the digest of everything that the site is made of."""
    content = sha256()
    further = [DOCS / "zensical.toml", Path(__file__), *(ROOT / name for name in INCLUDED)]
    for place, path in [*sources().items(), *((path.name, path) for path in further)]:
        content.update(place.encode() + b"\0" + sha256(path.read_bytes()).digest())
    return content.hexdigest()


def build() -> str | None:
    """Builds the site for the server unless it is current; returns the reason if it cannot, which the server shows."""
    current = digest()
    if (TARGET / STAMP).is_file() and (TARGET / STAMP).read_text(encoding="utf-8") == current:
        return None
    try:
        build_into(TARGET)
    except (DocumentationError, OSError) as error:
        shutil.rmtree(TARGET, ignore_errors=True)
        TARGET.mkdir(parents=True)
        (TARGET / REASON).write_text(f"{error}\n", encoding="utf-8")
        return str(error)
    (TARGET / STAMP).write_text(current, encoding="utf-8")
    return None


def main(arguments: list[str]) -> int:
    """Builds the site, or checks that it can be built."""
    if arguments == ["check"]:
        with TemporaryDirectory() as folder:
            try:
                build_into(Path(folder) / "site")
            except DocumentationError as error:
                print(error, file=sys.stderr)
                return 1
        return 0
    reason = build()
    if reason is not None:
        print(f"the documentation was not built: {reason}", file=sys.stderr)
    return 0 if reason is None else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
