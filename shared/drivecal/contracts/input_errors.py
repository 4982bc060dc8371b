"""Pydantic's errors as drivecal's problems: the field as the user wrote it, its fault and remedy."""

from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from itertools import pairwise
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from drivecal.contracts.strict_json import ONE_LINE, field_name, shown
from drivecal.domain.errors import InvalidInputError, Problem

Specification = TypeVar("Specification", bound=BaseModel)
Detail = Mapping[str, Any]
"""An entry of `ValidationError.errors()`."""
MOST_FINDINGS = 500
"""Errors of a document that are reported."""

_WANTED = {
    "string_type": "text",
    "string_unicode": "valid Unicode text",
    "int_type": "a whole number, without decimal point and exponent",
    "int_parsing": "a whole number",
    "int_parsing_size": "a smaller whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "date_type": "a date, YYYY-MM-DD",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "list_type": "a list",
    "dict_type": "an object",
    "model_type": "an object",
    "model_attributes_type": "an object",
    "none_required": "null, or leave it out: there is nothing to choose yet",
}

_BOUNDS: dict[str, tuple[str, str]] = {
    "greater_than_equal": ("is too small", "give at least {ge}"),
    "greater_than": ("is too small", "give more than {gt}"),
    "less_than_equal": ("is too large", "give at most {le}"),
    "less_than": ("is too large", "give less than {lt}"),
    "string_too_short": ("is too short", "give at least {min_length} characters"),
    "string_too_long": ("is too long", "give at most {max_length} characters"),
    "too_short": ("has too few entries", "give at least {min_length}"),
    "too_long": ("has too many entries", "give at most {max_length}"),
}

_PATTERNS = {
    r"^[A-Za-z][A-Za-z0-9_.-]*$": "start with a letter; go on with letters, digits, `_`, `.` or `-`",
    ONE_LINE: "leave out control characters and marks that change the direction of text",
}


def validated(model: type[Specification], document: object) -> Specification:
    """Returns `document` as a `model`.

    Raises InvalidInputError with every field that does not fit, or the first of very many.
    """
    try:
        return model.model_validate(document)
    except ValidationError as error:
        details = error.errors(include_url=False)[:MOST_FINDINGS]
    located = [(_path(detail, document), detail) for detail in details]
    misspelt = ((path, _known(model, detail["loc"][:-1])) for path, detail in located if detail["type"] == "extra_forbidden")
    meant = {_meant(path, known) for path, known in misspelt}
    located = [(path, detail) for path, detail in located if detail["type"] != "missing" or path not in meant]
    # Raised out here, without pydantic's error, which holds on to the whole document.
    raise InvalidInputError(*dict.fromkeys(_merged(located, model)))


def _meant(path: tuple[int | str, ...], known: Sequence[str]) -> tuple[int | str, ...] | None:
    """Returns the path of the known field that a misspelt one at `path` seems to mean: it is missing for this reason alone."""
    close = get_close_matches(str(path[-1]), known, n=1)
    return (*path[:-1], close[0]) if close else None


def _path(detail: Detail, document: object) -> tuple[int | str, ...]:
    """Returns the location without the names of union members, which pydantic inserts."""
    path: list[int | str] = []
    value, named = document, None
    for part in detail["loc"]:
        if isinstance(value, dict) and value.get("kind") == part and named is not value:
            named = value  # by its kind, which may have a field of this name, as `command` has
            continue
        here = isinstance(value, dict) and part in value
        here = here or (isinstance(value, list) and isinstance(part, int) and part < len(value))
        if here:
            value = value[part]  # type: ignore[index]  # `here` says that it can be indexed by it
            path.append(part)
    if detail["type"] == "missing":
        path.append(detail["loc"][-1])
    return tuple(path)


def _merged(located: Sequence[tuple[tuple[int | str, ...], Detail]], model: type[BaseModel]) -> list[Problem]:
    """Merges errors of a union: errors of the fitting member count, else the types that any member takes."""
    merged: list[Problem] = []
    for path, detail in located:
        if detail["type"] not in _WANTED:
            if detail["type"] == "extra_forbidden":
                remedy = nearest(str(path[-1]), _known(model, detail["loc"][:-1]))
                merged.append(Problem(field_name(path), "there is no such field", remedy))
            else:
                merged.append(problem(field_name(path), detail))
            continue
        others = [(other, entry) for other, entry in located if entry is not detail and other[: len(path)] == path]
        if any(len(other) > len(path) or entry["type"] not in _WANTED for other, entry in others):
            continue
        wanted = [_WANTED[detail["type"]], *(_WANTED[entry["type"]] for _, entry in others)]
        remedy = f"give {' or '.join(sorted(set(wanted), reverse=True))}"
        merged.append(Problem(field_name(path), _unfit(detail), remedy))
    return merged


def problem(field: str, detail: Detail) -> Problem:
    """Returns pydantic's error as a problem for the user."""
    kind, context, given = detail["type"], detail.get("ctx", {}), shown(detail.get("input"))
    if kind == "missing":
        return Problem(field, "the value is missing", "give it")
    if kind == "extra_forbidden":
        return Problem(field, "there is no such field", "leave it out")
    if kind in _WANTED:
        return Problem(field, _unfit(detail), f"give {_WANTED[kind]}")
    if kind in _BOUNDS:
        message, remedy = _BOUNDS[kind]
        return Problem(field, f"{given} {message}", remedy.format(**{key: _number(value) for key, value in context.items()}))
    if kind == "string_pattern_mismatch":
        remedy = _PATTERNS.get(context["pattern"], f"it must match {context['pattern']}")
        return Problem(field, f"'{given}' is not a valid name", remedy)
    if kind in {"union_tag_invalid", "union_tag_not_found"}:
        field += "." + context["discriminator"].strip("'")
        if kind == "union_tag_not_found":
            return Problem(field, "the value is missing", "give it")
        choices = context["expected_tags"].replace("'", "")
        return Problem(field, f"{shown(context['tag'])} is not one of the choices", f"give {choices}")
    if kind in {"literal_error", "enum"}:
        choices = context["expected"].replace("'", "").replace("False", "false").replace("True", "true")
        return Problem(field, f"{given} is not one of the choices", f"give {choices}")
    if kind == "value_error":
        message, _, remedy = str(context["error"]).partition("; ")
        return Problem(field, message, remedy)
    return Problem(field, _unfit(detail), detail["msg"])


def _unfit(detail: Detail) -> str:
    """Returns the message for a value of another type: of a text, which may look like a number, that it is one."""
    given = detail.get("input")
    return f"{'the text ' if isinstance(given, str) and given else ''}{shown(given)} does not fit"


def _known(model: type[BaseModel], path: Sequence[int | str]) -> list[str]:
    """Returns the fields of the model at a path. Behind the field of a union, a path may name the `kind` of its member."""
    current = model
    for part, kind in pairwise([*path, ""]):
        if isinstance(part, str) and part in current.model_fields:
            inner = list(_inner_models(current.model_fields[part].annotation))
            fitting = (
                each for each in inner if "kind" in each.model_fields and kind in get_args(each.model_fields["kind"].annotation)
            )
            current = next(fitting, inner[0] if inner else current)
    return list(current.model_fields)


def _inner_models(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _inner_models(argument)


def nearest(name: str, known: Sequence[str]) -> str:
    """Returns the remedy for a misspelt name: the most similar known name, or all of them."""
    close = get_close_matches(name, known, n=1)
    return f"did you mean {close[0]}?" if close else f"known are {', '.join(known)}"


def _number(value: object) -> str:
    return (
        f"{value:,}" if isinstance(value, int) and value < 10**12 else f"{value:g}" if isinstance(value, float) else str(value)
    )
