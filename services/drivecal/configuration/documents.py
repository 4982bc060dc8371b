"""Reads the files that users write, YAML or JSON, into the plain data of a REST body."""

import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from drivecal.contracts import strict_json
from drivecal.contracts.strict_yaml import located_yaml
from drivecal.domain.errors import InvalidInputError, Problem, file_faults, restated

LARGEST_FILE = 1_048_576
"""Bytes, as the server accepts them."""


def read_document(file: str) -> dict[str, Any]:
    """Returns the object in `file`, `-` for standard input. Raises InvalidInputError with file, line and column of the fault."""
    return _located_document(file)[0]


@contextmanager
def opened_document(file: str) -> Iterator[dict[str, Any]]:
    """Yields the object in `file`, as `read_document` returns it. Faults that the server, for example, finds in it get file and line."""
    document, name, lines = _located_document(file)
    with restated(lambda problem: replace(problem, field=located(problem.field, lines, name))):
        yield document


def located(field: str, lines: Mapping[str, int], name: str) -> str:
    """Returns a field with file and line: its own, or that of the section that lacks it."""
    owner = field
    while owner and owner not in lines:
        owner = re.sub(r"(?:\.?[^.\[]*|\[\d*\]?)$", "", owner)
    line = f"line {lines[owner]}" if owner else ""
    return ": ".join(filter(None, (name, line, field)))


def _located_document(file: str) -> tuple[dict[str, Any], str, Mapping[str, int]]:
    """Returns the object in `file`, the file's name, and the lines of its fields."""
    content, name = _content(file)
    lines: Mapping[str, int] = {}
    with restated(lambda problem: replace(problem, field=": ".join(filter(None, (name, problem.field))))):
        if name.endswith(".json") or (file == "-" and re.match(rb'\s*[{\[]\s*["}\]]', content)):
            document = strict_json.loads(content)
            with suppress(InvalidInputError):  # JSON that is no YAML has no lines
                lines = located_yaml(content)[1]
        else:
            document, lines = located_yaml(content)
        strict_json.check_plain(document)
    if not isinstance(document, dict):
        raise InvalidInputError(
            Problem(name, f"it holds {strict_json.shown(document)}, not an object", "write `field: value` lines")
        )
    return document, name, lines


def _content(file: str) -> tuple[bytes, str]:
    name = "standard input" if file == "-" else file
    with (
        file_faults(name, "read", "give a YAML or JSON file, or -"),
        nullcontext(sys.stdin.buffer) if file == "-" else Path(file).open("rb") as stream,
    ):
        content = stream.read(LARGEST_FILE + 1)
    if len(content) > LARGEST_FILE:
        raise InvalidInputError(Problem(name, f"it is larger than {LARGEST_FILE:,} bytes", "give a smaller file"))
    return content, name
