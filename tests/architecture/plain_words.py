"""Lists phrases that make a reader stop: `.venv/bin/python tests/architecture/plain_words.py [FOLDER ...]`.

Each line has file, line, pattern and text. Looked through are docstrings, comments and names of Python, comments of the page's sources, and
the pages of the documentation. Words in backticks or in blocks of code count only if the pattern has backticks itself.
"""

import ast
import io
import re
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROSE = {
    "of which": r"\b(?:of|in|by) which\b",
    "beside": r"\bbeside\b",
    "so many": r"\bso many\b",
    "nobody": r"\b(?:nobody|somebody|whoever|whomever)\b",
    "those that": r"\bthose (?:that|of|which|who)\b",
    "one that": r"\bones? that\b|\b(?:the|that) one of\b",
    "from ... on": r"\bfrom (?:[\w'-]+ ){1,5}on(?=[,.;:)]|$)",
}
"""Patterns of any text, without its code."""
PARAMETER = "`name`: of"
PARAMETERS = re.compile(r"`[\w.]+`(?:(?:,| and) `[\w.]+`)*: (?:of|for|in|by|to|from|at|whether|what|where|if)\b", re.IGNORECASE)
OPENER = "opener"
OPENERS = re.compile(r"(?:What|Of|Those|Who|That|Where|Whether)\b")
"""First words of docstrings."""
LINES = {"share without a blank": r"\d%(?!\w)"}
"""Patterns of any line but markup: code and printed output have `5 %`, too."""
NAMES = {"one as a name": r"\bfor one in\b", "found =": r"^\s*found\b[^=]* = "}
"""Patterns of lines of Python code."""
SPAN = re.compile(r"`[^`\n]*`")
BLOCK = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\([^)]*\)")
COMMENT = re.compile(r"/\*.*?\*/|<!--.*?-->|(?<![:\w\"'`])//[^\n]*", re.DOTALL)
"""Comments of TypeScript and Svelte."""
MAYBE_COMMENT = re.compile(r"(?=(#.*))")
MAYBE_DOCSTRING = re.compile(r'^(?=[ \t]*[rR]?"""(.*?)""")', re.MULTILINE | re.DOTALL)
BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")
"""Fields of a syntax tree that hold statements."""


@dataclass(frozen=True, slots=True)
class Phrase:
    """An unclear phrase: file relative to the project, line, pattern, text of the line."""

    file: str
    line: int
    pattern: str
    text: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.pattern}: {self.text}"


def phrases_in(*folders: str) -> list[Phrase]:
    """Returns the unclear phrases of all files below these folders, of the whole project if there are none."""
    listing = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *(folders or (".",))]
    names = subprocess.run(listing, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    return [phrase for name in sorted(names) if (ROOT / name).is_file() for phrase in phrases_of(name)]


def phrases_of(name: str) -> Iterator[Phrase]:
    """Yields the unclear phrases of a file."""
    kind = Path(name).suffix
    if kind not in {".py", ".ts", ".svelte", ".md"} or (kind == ".md" and not name.startswith("docs/pages/")):
        return
    text = (ROOT / name).read_text(encoding="utf-8")
    lines = text.splitlines()
    parts = python_prose(text) if kind == ".py" else page_prose(text) if kind == ".md" else script_comments(text)
    places = {place for start, part, is_docstring in parts for place in patterns_in(start, part, is_docstring=is_docstring)}
    likely = {**LINES, **(NAMES if kind == ".py" else {})}
    likely = {pattern: regex for pattern, regex in likely.items() if re.search(regex, text, re.MULTILINE)}
    if kind != ".svelte" and likely:
        places |= {
            (number, pattern)
            for number, line in enumerate(lines, start=1)
            for pattern, regex in likely.items()
            if re.search(regex, line)
        }
    for number, pattern in sorted(places):
        yield Phrase(name, number, pattern, lines[number - 1].strip()[:120])


def patterns_in(start: int, text: str, *, is_docstring: bool) -> Iterator[tuple[int, str]]:
    """Yields line and pattern of each unclear phrase.

    Args:
        start: line of the text's first character.
        text: docstring, comment or page.
        is_docstring: includes the rule for first words.
    """

    def line_of(position: int) -> int:
        return start + text.count("\n", 0, position)

    if is_docstring and OPENERS.match(text.strip()):
        yield line_of(len(text) - len(text.lstrip())), OPENER
    for match in PARAMETERS.finditer(text):
        yield line_of(match.start()), PARAMETER
    bare = SPAN.sub(lambda span: " " * len(span[0]), text)
    for pattern, regex in PROSE.items():
        for match in re.finditer(regex.replace(" ", r"\s+"), bare, re.IGNORECASE):
            yield line_of(match.start()), pattern


def python_prose(text: str) -> Iterator[tuple[int, str, bool]]:
    """Yields line, text and kind of each comment and docstring, docstrings of attributes included."""
    is_suspect = any(any(patterns_in(1, part[1], is_docstring=True)) for part in MAYBE_DOCSTRING.finditer(text))
    nodes: list[ast.AST] = [ast.parse(text)] if is_suspect else []  # to parse takes longer than all else
    for node in nodes:  # statements alone: to walk through expressions takes as long as all else
        nodes += [statement for block in BLOCKS for statement in getattr(node, block, ())]
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value, True
    if not any(any(patterns_in(1, part[1], is_docstring=False)) for part in MAYBE_COMMENT.finditer(text)):
        return  # to find where comments begin takes longer than all else
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string, False


def script_comments(text: str) -> Iterator[tuple[int, str, bool]]:
    """Yields line and text of the comments of TypeScript or Svelte."""
    for comment in COMMENT.finditer(text):
        yield text.count("\n", 0, comment.start()) + 1, comment[0], False


def page_prose(text: str) -> Iterator[tuple[int, str, bool]]:
    """Yields a page without its code and its targets of links."""

    def blank(match: re.Match[str]) -> str:
        return re.sub(r"[^\n]", " ", match[0])

    yield 1, LINK.sub(blank, BLOCK.sub(blank, text)), False


if __name__ == "__main__":
    phrases = phrases_in(*sys.argv[1:])
    print("\n".join(map(str, phrases)))
    print(f"{len(phrases)} unclear phrases", file=sys.stderr)
