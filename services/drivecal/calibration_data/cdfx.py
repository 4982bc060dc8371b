"""CDF 2.x (ASAM Calibration Data Format, `.cdfx`): scalar values with their quality data (history)."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element, SubElement, indent, tostring  # writes only
from xml.parsers import expat  # entities, which make XML dangerous, are refused below

from drivecal.calibration_data.characteristics import (
    LARGEST_FILE,
    Characteristic,
    Content,
    Quality,
    number_or_fault,
    on_one_line,
    refused,
    unit_of,
)
from drivecal.contracts.strict_json import shown

DOCTYPE = '<!DOCTYPE MSRSW PUBLIC "-//ASAM//DTD CALIBRATION DATA FORMAT:V2.0.0:LAI:IAI:XML:CDF200.XSD//EN" "cdf_v2.0.0.sl.dtd">'
SCALARS = frozenset({"VALUE", "BOOLEAN", "ASCII"})
TRUTHS = ("false", "true")
CODES = (0.0, 1.0)
DEEPEST = 64


def write(characteristics: Sequence[Characteristic], quality: Quality | None = None, name: str = "drivecal") -> bytes:
    """Returns a CDF 2.0 file. Numbers keep all their digits; equal content gives equal bytes."""
    root = Element("MSRSW")
    _add(root, "SHORT-NAME", name)
    _add(root, "CATEGORY", "CDF20")
    system = SubElement(SubElement(root, "SW-SYSTEMS"), "SW-SYSTEM")
    _add(system, "SHORT-NAME", name)
    tree = SubElement(SubElement(system, "SW-INSTANCE-SPEC"), "SW-INSTANCE-TREE")
    _add(tree, "SHORT-NAME", "STD")
    _add(tree, "CATEGORY", "NO_VCD")
    for characteristic in characteristics:
        _instance(tree, characteristic, quality)
    indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{DOCTYPE}\n{tostring(root, encoding="unicode")}\n'.encode()


def _instance(tree: Element, characteristic: Characteristic, quality: Quality | None) -> None:
    instance = SubElement(tree, "SW-INSTANCE")
    _add(instance, "SHORT-NAME", characteristic.name)
    if characteristic.description:
        _add(instance, "LONG-NAME", characteristic.description)
    _add(instance, "CATEGORY", "BOOLEAN" if set(characteristic.choices) == set(TRUTHS) else "VALUE")
    if characteristic.value is not None:
        container = SubElement(instance, "SW-VALUE-CONT")
        _add(container, "UNIT-DISPLAY-NAME", "-" if characteristic.unit == "1" else characteristic.unit)
        values = SubElement(container, "SW-VALUES-PHYS")
        if isinstance(characteristic.value, str):
            _add(values, "VT", characteristic.value)
        else:
            _add(values, "V", repr(characteristic.value))
    if quality is not None:
        entry = SubElement(SubElement(instance, "SW-CS-HISTORY"), "CS-ENTRY")
        for tag, text in (
            ("STATE", quality.state),
            ("DATE", quality.date),
            ("CSUS", "drivecal"),
            ("CSPR", quality.project),
            ("CSWP", quality.work_product),
            ("CSTO", quality.test_object),
            ("CSPI", quality.campaign),
            ("CSDI", quality.data),
        ):
            if text:
                _add(entry, tag, text)
        for figure, text in quality.figures:
            _add(entry, "SD", text).set("GID", figure)


def _add(parent: Element, tag: str, text: str) -> Element:
    element = SubElement(parent, tag)
    element.text = on_one_line(text)
    return element


@dataclass(slots=True)
class _Node:
    """An element: its name without a namespace, its text, its children and its line."""

    tag: str
    line: int
    text: str = ""
    children: "list[_Node]" = field(default_factory=list)

    def all(self, tag: str) -> "list[_Node]":
        return [child for child in self.children if child.tag == tag]

    def first(self, *path: str) -> "_Node | None":
        node: _Node | None = self
        for tag in path:
            node = next(iter(node.all(tag)), None) if node is not None else None
        return node

    def words(self, *path: str) -> str:
        node = self.first(*path)
        return "" if node is None else " ".join(node.text.split())


def read(content: bytes, file: str) -> Content:
    """Returns the scalar values of a file; members of structures are called `structure.member`.

    Raises InvalidInputError with the line of the first fault, also for entities, which could blow up or read files.
    """
    root = _parsed(content, file)
    category = root.words("CATEGORY")
    if root.tag != "MSRSW" or not category.startswith("CDF2"):
        raise refused(
            file, root.line, f"it is not a CDF 2 file, but {shown(root.tag)} {shown(category)}", "export it as CDF 2.0 or 2.1"
        )
    result = Content()
    names: set[str] = set()
    for node, name in _instances(root, ""):
        characteristic = _scalar(node, name, file)
        if characteristic is None:
            result.skipped.append(name)
        else:
            result.add(file, characteristic, names)
            names.add(name)
    return result


def _parsed(content: bytes, file: str) -> _Node:
    if len(content) > LARGEST_FILE:
        raise refused(file, 0, f"it has more than {LARGEST_FILE >> 20} MB", "give a smaller file")
    parser = expat.ParserCreate()
    parser.buffer_text = True
    document = _Node("", 0)
    path = [document]

    def start(tag: str, _: object) -> None:
        node = _Node(tag.rpartition(":")[2], parser.CurrentLineNumber)
        path[-1].children.append(node)
        path.append(node)
        if len(path) > DEEPEST:
            raise ValueError("its elements are nested too deeply")

    def end(_: str) -> None:
        path.pop()

    def text(characters: str) -> None:
        path[-1].text += characters

    def refuse(*_: object) -> None:
        raise ValueError("entities are not supported")

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, end, text
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        reason = expat.ErrorString(error.code) if isinstance(error, expat.ExpatError) else str(error)
        raise refused(file, parser.CurrentLineNumber, f"the XML cannot be read: {reason}", "export it again") from error
    return document.children[0]


def _instances(node: _Node, prefix: str) -> Iterator[tuple[_Node, str]]:
    """Yields the instances without members of their own, with their names."""
    for child in node.children:
        if child.tag != "SW-INSTANCE":
            yield from _instances(child, prefix)
            continue
        own = child.words("SHORT-NAME")
        name = f"{prefix}.{own}".removeprefix(".") if own else f"{prefix}[{child.words('SW-ARRAY-INDEX')}]"
        if child.all("SW-INSTANCE"):
            yield from _instances(child, name)
        else:
            yield child, name


def _scalar(node: _Node, name: str, file: str) -> Characteristic | None:
    """Returns a scalar, or None if the instance is something else, or has no value or several (arrays, variants)."""
    category = node.words("CATEGORY")
    variants = node.first("SW-INSTANCE-PROPS-VARIANTS")
    held = node.all("SW-VALUE-CONT") or [
        container
        for variant in (variants.all("SW-INSTANCE-PROPS-VARIANT") if variants else ())
        for container in variant.all("SW-VALUE-CONT")
    ]
    values = held[0].first("SW-VALUES-PHYS") if len(held) == 1 else None
    given = [] if values is None else [child for child in values.children if child.tag in {"V", "VF", "VT"}]
    if len(given) != 1 or category not in SCALARS:
        return None
    if not name:
        raise refused(file, node.line, "an instance has no SHORT-NAME", "give it a name")
    text = given[0].text.strip()
    value, fault = (text, None) if given[0].tag == "VT" else number_or_fault(text, given[0].line, file)
    unit = unit_of(held[0].words("UNIT-DISPLAY-NAME"))
    is_truth = category == "BOOLEAN" and value in {*TRUTHS, *CODES}
    choices, codes = (TRUTHS, CODES) if is_truth else ((), ())
    return Characteristic(name, value, unit, node.words("LONG-NAME"), choices=choices, codes=codes, line=node.line, fault=fault)
