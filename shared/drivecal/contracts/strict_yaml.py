"""Reads YAML that comes from outside by its 1.2 core schema: `no` and `on` are words, `1e-3` is a number, dates stay text.

Duplicate keys, tags and aliases are refused: with aliases, a short file can expand without end. So are more values than JSON may have:
PyYAML reads them slowly, and its reader in C offers no place to refuse them.
"""

import math
import re
from collections.abc import Hashable
from typing import Any

import yaml

from drivecal.contracts import strict_json
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader with the core schema, unique keys, no aliases, no tags, and a limit of values."""

    values = 0
    """Values composed so far; keys are not counted."""
    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012  # PyYAML declares it this way

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]  # PyYAML ships no type for it
        if isinstance(event, yaml.AliasEvent):
            raise _refusal("aliases are not supported", event.start_mark, "write the value out")
        if getattr(event, "tag", None) is not None:
            raise _refusal(f"the tag {shown(event.tag)} is not supported", event.start_mark, "write the plain value")
        is_key = isinstance(parent, yaml.MappingNode) and index is None
        self.values += not is_key
        if self.values > strict_json.MOST_VALUES:
            message = f"the document has more than {strict_json.MOST_VALUES:,} values"
            raise _refusal(message, event.start_mark, "write a shorter document; a problem may keep data in other files")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:  # noqa: ARG002, FBT001, FBT002  # PyYAML's signature
        seen: set[str] = set()
        for key, _ in node.value:
            if key.tag != "tag:yaml.org,2002:str":
                raise _refusal(f"the key {shown(key.value)} is not a text", key.start_mark, "put it in quotes")
            if key.value in seen:
                raise _refusal(f"the key {shown(key.value)} appears twice", key.start_mark, "give each key once")
            seen.add(key.value)
        return super().construct_mapping(node, deep=True)

    def construct_core_int(self, node: yaml.ScalarNode) -> int:
        text = self.construct_scalar(node)
        if len(text) > 100:
            raise _refusal(f"a number of {len(text)} digits is too large", node.start_mark, "give a smaller number")
        return int(text, 0) if text.startswith(("0x", "0o")) else int(text)

    def construct_core_float(self, node: yaml.ScalarNode) -> float:
        text = self.construct_scalar(node).lower()
        value = float(text.replace(".inf", "inf").replace(".nan", "nan"))
        if not math.isfinite(value):
            raise _refusal(f"{shown(text)} is not a finite number", node.start_mark, "give a finite number, or null")
        return value


for tag, pattern, first in (
    ("null", r"^(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    ("bool", r"^(?:true|True|TRUE|false|False|FALSE)$", list("tTfF")),
    ("int", r"^(?:[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)$", list("-+0123456789")),
    (
        "float",
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$",
        list("-+.0123456789"),
    ),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{tag}", re.compile(pattern), first)
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_core_int)
_Loader.add_constructor("tag:yaml.org,2002:float", _Loader.construct_core_float)


def located_yaml(content: bytes) -> tuple[object, dict[str, int]]:
    """Returns a YAML document, and the line of each of its fields, e.g. of `parameters[0].lower`. Raises InvalidInputError."""
    try:
        loader = _Loader(content.decode("utf-8-sig"))
        try:
            node = loader.get_single_node()
            document = None if node is None else loader.construct_document(node)
        finally:
            loader.dispose()
    except UnicodeDecodeError as error:
        raise InvalidInputError(Problem("", f"byte {error.start} is not valid UTF-8", "save the file as UTF-8")) from error
    except yaml.MarkedYAMLError as error:
        raise _unreadable(content.decode("utf-8-sig"), error) from error
    except yaml.YAMLError as error:
        raise InvalidInputError(Problem("", f"no valid YAML: {' '.join(str(error).split())}", "correct the file")) from error
    except RecursionError as error:
        raise InvalidInputError(Problem("", "it is nested too deeply", "write a flatter document")) from error
    return document, {} if node is None else _lines(node)


def _unreadable(text: str, error: yaml.MarkedYAMLError) -> InvalidInputError:
    """Returns the refusal of a text that is no YAML; of a line that fits no block, in words about its indentation."""
    message, mark = str(error.problem or error.context), error.problem_mark or error.context_mark
    if message.startswith("mapping values"):
        remedy = "put a text that holds `: ` into quotes; a field of its own begins where its neighbours begin"
        return _refusal("a second `: ` begins a field where none can be", mark, remedy)
    if mark is None or not message.startswith("expected <block end>"):
        return _refusal(message, mark)
    *before, line = text.splitlines()[: mark.line + 1]
    earlier = next((other for other in reversed(before) if other.strip() and not other.lstrip().startswith("#")), line)
    here, there = (len(other) - len(other.lstrip(" ")) for other in (line, earlier))
    if here == there:
        return _refusal("what begins here does not belong to what is before it", mark, "check the indentation of this line")
    message = f"this line is indented by {here} space{'' if here == 1 else 's'}, the line before it by {there}"
    return _refusal(message, mark, "indent the fields of one object equally")


def _lines(root: yaml.Node) -> dict[str, int]:
    lines: dict[str, int] = {}
    waiting: list[tuple[yaml.Node, tuple[str | int, ...], int]] = [(root, (), 1)]
    while waiting:
        node, path, line = waiting.pop()
        lines[strict_json.field_name(path)] = line
        if len(path) >= strict_json.DEEPEST:
            continue
        if isinstance(node, yaml.MappingNode):
            waiting.extend((value, (*path, key.value), key.start_mark.line + 1) for key, value in node.value)
        elif isinstance(node, yaml.SequenceNode):
            waiting.extend((value, (*path, index), value.start_mark.line + 1) for index, value in enumerate(node.value))
    return lines


def _refusal(message: str, mark: Any, remedy: str = "correct the file there") -> InvalidInputError:
    where = f"line {mark.line + 1}, column {mark.column + 1}" if mark else ""
    return InvalidInputError(Problem(where, message, remedy))
