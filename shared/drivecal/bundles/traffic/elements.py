"""Small XML documents as trees that record which parts were read: the rest is listed as ignored."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace

from drivecal.bundles.traffic.expressions import ExpressionError, evaluated
from drivecal.contracts.assignments import finite_number
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.roads.documents import Attributes, cut, read_elements

MOST_ELEMENTS = 200_000
LONGEST_NOTE = 200
"""Characters of a note on attributes."""
NAMING = ("name",)
"""Attributes that only name elements."""
Substitution = Callable[["Element", str], str]
"""Returns the text of an attribute with a parameter in it."""


class Element(Attributes):
    """An element with those inside of it. Its attributes are read as `Attributes` does, with parameters replaced by their values."""

    __slots__ = ("children", "is_read", "known", "parameters", "parent", "substitution")

    def __init__(self, attributes: Attributes, parent: "Element | None", substitution: Substitution | None) -> None:
        super().__init__(attributes.file, attributes.element, attributes.values, attributes.line)
        self.parent, self.substitution = parent, substitution
        self.children: list[Element] = []
        self.parameters: dict[str, str] = {}
        """Values of the parameters that are declared here."""
        self.is_read = False
        self.known: list[str] = []
        """Attributes that were read."""

    def copy(self, parent: "Element | None" = None) -> "Element":
        """Returns the element with all inside of it, below `parent` or its own."""
        copied = Element(self, parent or self.parent, self.substitution)
        copied.parameters = dict(self.parameters)
        copied.children = [child.copy(copied) for child in self.children]
        return copied

    def text(self, key: str, default: str | None = None) -> str:
        """Returns an attribute. Raises InvalidInputError if it is missing and has no default."""
        self.known.append(key)
        text = super().text(key, default)
        return text if self.substitution is None or "$" not in text else self.substitution(self, text)

    def parameter(self, key: str) -> str:
        """Returns an attribute that names a parameter, with or without a dollar sign. Raises InvalidInputError if it is missing."""
        self.known.append(key)
        return super().text(key).strip().removeprefix("$")

    def decides(self, key: str, default: str) -> bool:
        """Returns a truth value: true, false, 1 or 0. Raises InvalidInputError for others."""
        text = self.text(key, default).strip().lower()
        if text not in {"true", "false", "1", "0"}:
            raise self.fault(f"{key} is {text[:40]!r}, which is neither true nor false", "correct it")
        return text in {"true", "1"}

    def word(self, key: str, known: Mapping[str, object] | tuple[str, ...], default: str | None = None) -> str:
        """Returns an attribute that is one of `known`. Raises InvalidInputError for others."""
        text = self.text(key, default)
        if text not in known:
            raise self.fault(f"{key} is {text[:60]!r}, which is not supported", f"give one of {', '.join(known)}")
        return text

    def every(self, *tags: str) -> "list[Element]":
        """Returns the elements with these tags inside of this one, in the order of the file."""
        inside = [child for child in self.children if child.element in tags]
        for child in inside:
            child.is_read = True
        return inside

    def optional(self, *tags: str) -> "Element | None":
        """Returns the element with one of these tags, None if there is none. Raises InvalidInputError if there are several."""
        inside = self.every(*tags)
        if len(inside) > 1:
            raise inside[1].fault(f"<{self.element}> has several of them", "give one")
        return inside[0] if inside else None

    def only(self, *tags: str) -> "Element":
        """Returns the element with one of these tags. Raises InvalidInputError if there is none, or several."""
        child = self.optional(*tags)
        if child is None:
            others = [f"<{other.element}> (line {other.line})" for other in self.children[:3]]
            message = f"{' and '.join(others)} is not supported" if others else f"there is no <{tags[0]}>"
            raise self.fault(message, f"give {' or '.join(f'<{tag}>' for tag in tags)}")
        return child

    def entity(self, ids: Mapping[str, str]) -> str:
        """Returns the id of the entity that this element refers to. Raises InvalidInputError if it is not in `ids`."""
        name = self.text("entityRef")
        if name not in ids:
            raise self.fault(f"there is no entity {name[:60]!r}", f"give one of {', '.join(list(ids)[:10])}")
        return ids[name]

    def skip(self) -> None:
        """Marks everything in this element as read."""
        self.is_read = True
        self.known += self.values
        for child in self.children:
            child.skip()

    def unread(self) -> "Iterator[Element]":
        """Yields the outermost elements that were not read."""
        for child in self.children:
            if child.is_read:
                yield from child.unread()
            else:
                yield child

    def read_in_part(self) -> "Iterator[tuple[Element, list[str]]]":
        """Yields the elements that were read in part, with their unread attributes."""
        if rest := [key for key in self.values if key not in NAMING and key not in self.known]:
            yield self, rest
        for child in self.children:
            if child.is_read:
                yield from child.read_in_part()


class Notes:
    """Notes on a file: what is ignored or driven otherwise, with the lines."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._lines: dict[tuple[str, str, str], list[int]] = {}

    def add(self, element: Attributes, text: str) -> None:
        """Adds a note on an element."""
        self._lines.setdefault((element.file, element.element, text), []).append(element.line)

    def texts(self, root: Element) -> tuple[str, ...]:
        """Returns the notes, merged if their text is equal, and a note on each unread element and attribute below `root`.

        Attributes of entities get no note: masses, names of models and heights do not change the drive.
        """
        for element in root.unread():
            self.add(element, "ignored")
        for section in root.every("Storyboard"):
            for element, keys in section.read_in_part():
                self.add(element, f"ignored: {', '.join(keys)}"[:LONGEST_NOTE])
        notes = sorted(self._lines.items(), key=lambda entry: (entry[0][0] != self._name, entry[0][0], entry[1][0]))
        texts = cut(f"{file}: {_lines(sorted(lines))}, <{tag}>: {text}" for (file, tag, text), lines in notes)
        return tuple(text if ": " in text else f"{self._name}: {text}" for text in texts)


def _lines(lines: list[int]) -> str:
    shown = ", ".join(map(str, lines[:10]))
    more = f" and {len(lines) - 10} more" if len(lines) > 10 else ""
    return f"line{'s' if len(lines) > 1 else ''} {shown}{more}"


def read_tree(content: bytes, name: str, root: str, substitution: Substitution | None = None) -> Element:
    """Returns the document's element. `name`: the file's in messages; `root`: its tag. Raises InvalidInputError."""
    stack: list[Element] = []
    whole: list[Element] = []
    count = 0

    def start(attributes: Attributes) -> None:
        nonlocal count
        count += 1
        if count > MOST_ELEMENTS:
            raise attributes.fault(f"the document has more than {MOST_ELEMENTS:,} elements", "cut the part out that is driven")
        element = Element(attributes, stack[-1] if stack else None, substitution)
        (stack[-1].children if stack else whole).append(element)
        stack.append(element)

    def end(_: str) -> None:
        stack.pop()

    read_elements(content, name, root, start, end)
    whole[0].is_read = True
    return whole[0]


def in_file(problem: Problem, place: str) -> Problem:
    """Returns a problem with the field `place`, whose message says where in the file it is."""
    return replace(problem, field=place, message=f"{problem.field}: {problem.message}")


_NAME = re.compile(r"\$([A-Za-z_][A-Za-z0-9_.]*)")
_RULES = {
    "equalTo": lambda value, limit: value == limit,
    "notEqualTo": lambda value, limit: value != limit,
    "greaterThan": lambda value, limit: value > limit,
    "greaterOrEqual": lambda value, limit: value >= limit,
    "lessThan": lambda value, limit: value < limit,
    "lessOrEqual": lambda value, limit: value <= limit,
}


def substituted(element: Element, text: str) -> str:
    """Returns the text of an attribute with its parameters replaced. Raises InvalidInputError."""
    text = text.strip()
    if text.startswith("${") and text.endswith("}"):
        return _computed(element, text[2:-1])
    match = _NAME.fullmatch(text)
    if match is None:
        raise element.fault(f"{shown(text)} is not a parameter", "give $name or ${expression}")
    return _value(element, match[1])


def named_once(elements: Iterable[tuple[str, Element]]) -> dict[str, Element]:
    """Returns elements by their names. Raises InvalidInputError if two have the same name."""
    named: dict[str, Element] = {}
    for name, element in elements:
        if (other := named.setdefault(name, element)) is not element:
            raise element.fault(f"the name {shown(name)} stands in line {other.line}, too", "rename it, or leave it out")
    return named


def declare(owner: Element, given: Mapping[str, object]) -> None:
    """Takes the declarations inside of an element, with other values for some. Raises InvalidInputError with fields `parameters.name`."""
    section = owner.optional("ParameterDeclarations")
    declarations = section.every("ParameterDeclaration") if section is not None else []
    for name, declaration in named_once((each.parameter("name"), each) for each in declarations).items():
        owner.parameters[name] = _text(given[name]) if name in given else declaration.text("value")
    known = list(owner.parameters)
    for name in given:
        if name not in owner.parameters:
            raise InvalidInputError(Problem(f"parameters.{name}", "the file declares no such parameter", nearest(name, known)))
    for declaration in declarations:
        _check(declaration, declaration.parameter("name"), given)


def _check(declaration: Element, name: str, given: Mapping[str, object]) -> None:
    """Raises InvalidInputError if a value fulfils none of its groups of constraints."""
    groups = declaration.every("ConstraintGroup")
    value = _value(declaration, name)
    for group in groups:
        group.skip()
    if groups and not any(all(_holds(limit, value) for limit in group.every("ValueConstraint")) for group in groups):
        message = f"{shown(value)} breaks its constraints in the file"
        if name in given:
            raise InvalidInputError(Problem(f"parameters.{name}", message, f"see line {declaration.line}"))
        raise declaration.fault(message, "give another value in `parameters`")


def parameter_holds(condition: Element) -> bool:
    """Returns whether a ParameterCondition holds: parameters keep their values in a run. Raises InvalidInputError."""
    return _holds(condition, _value(condition, condition.parameter("parameterRef")))


def _holds(limit: Element, value: str) -> bool:
    rule, other = limit.word("rule", _RULES), limit.text("value")
    numbers = finite_number(value), finite_number(other)
    if None in numbers:
        return {"equalTo": value == other, "notEqualTo": value != other}.get(rule, False)
    return bool(_RULES[rule](*numbers))


def _computed(element: Element, expression: str) -> str:
    values: dict[str, float | bool] = {}

    def named(match: re.Match[str]) -> str:
        name, text = f"p{len(values)}_", _value(element, match[1])
        number = {"true": True, "false": False}.get(text.strip().lower(), finite_number(text))
        if number is None:
            raise element.fault(f"the parameter {shown(match[1])} is not a number", "give it a number")
        values[name] = number
        return name

    try:
        return _text(evaluated(_NAME.sub(named, expression), values))
    except ExpressionError as error:
        raise element.fault(f"{shown('${' + expression + '}')}: {error.message}", error.remedy) from error


def _value(element: Element, name: str) -> str:
    """Returns the value of a parameter: of the innermost declaration around an element."""
    known: list[str] = []
    owner: Element | None = element
    while owner is not None:
        if name in owner.parameters:
            return owner.parameters[name]
        known += owner.parameters
        owner = owner.parent
    raise element.fault(f"there is no parameter {shown(name)}", nearest(name, known))


def _text(value: object) -> str:
    """Returns a value of a scenario as the file would write it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    return str(value)
