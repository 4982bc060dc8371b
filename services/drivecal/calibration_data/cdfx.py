"""CDF 2.x (ASAM Calibration Data Format, `.cdfx`): values, curves and maps with their quality data (history)."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from xml.etree.ElementTree import Element, SubElement, indent, tostring  # writes only
from xml.parsers import expat  # entities, which make XML dangerous, are refused below

from drivecal.calibration_data.characteristics import (
    INDEX,
    LARGEST_FILE,
    Axis,
    Characteristic,
    Content,
    Places,
    Quality,
    extents,
    index,
    number_or_fault,
    on_one_line,
    problem_of,
    refused,
    unit_of,
)
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import Problem

DOCTYPE = '<!DOCTYPE MSRSW PUBLIC "-//ASAM//DTD CALIBRATION DATA FORMAT:V2.0.0:LAI:IAI:XML:CDF200.XSD//EN" "cdf_v2.0.0.sl.dtd">'
SCALARS = frozenset({"VALUE", "BOOLEAN", "ASCII"})
_KINDS = {"CURVE": "CURVE", "MAP": "MAP", "VAL_BLK": "VAL_BLK", "VALUE_ARRAY": "VAL_BLK", "COM_AXIS": "COM_AXIS"}
_AXES = frozenset({"STD_AXIS", "FIX_AXIS", "COM_AXIS", "RES_AXIS", INDEX})
_HISTORY = ("STATE", "DATE", "CSUS", "CSPR", "CSWP", "CSTO", "CSPI", "CSDI")
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
    _add(instance, "CATEGORY", "BOOLEAN" if set(characteristic.choices) == set(TRUTHS) else characteristic.kind)
    if characteristic.given is not None:
        container = SubElement(instance, "SW-VALUE-CONT")
        _add(container, "UNIT-DISPLAY-NAME", _unit(characteristic.unit))
        if characteristic.kind == "VAL_BLK":
            _numbers(SubElement(container, "SW-ARRAYSIZE"), [float(len(axis.points)) for axis in characteristic.axes], "{:.0f}")
        values = SubElement(container, "SW-VALUES-PHYS")
        if isinstance(characteristic.value, str):
            SubElement(values, "VT").text = characteristic.value
        elif characteristic.value is not None:
            _numbers(values, [characteristic.value])
        for row in characteristic.rows:
            _numbers(SubElement(values, "VG") if len(characteristic.axes) > 1 else values, row)
    if characteristic.kind in {"CURVE", "MAP"}:
        axes = SubElement(instance, "SW-AXIS-CONTS")
        for axis in characteristic.axes:
            described = SubElement(axes, "SW-AXIS-CONT")
            _add(described, "CATEGORY", axis.kind)
            _add(described, "UNIT-DISPLAY-NAME", _unit(axis.unit))
            if axis.shared:
                _add(described, "SW-INSTANCE-REF", axis.shared)
            _numbers(SubElement(described, "SW-VALUES-PHYS"), axis.points)
    if quality is not None:
        entry = SubElement(SubElement(instance, "SW-CS-HISTORY"), "CS-ENTRY")
        of_set = quality.project, quality.work_product, quality.test_object, quality.campaign, quality.data
        for tag, text in zip(_HISTORY, (quality.state, quality.date, "drivecal", *of_set), strict=True):
            if text:
                _add(entry, tag, text)
        for figure, text in quality.figures:
            _add(entry, "SD", text).set("GID", figure)


def _unit(unit: str) -> str:
    return "-" if unit == "1" else unit


def _numbers(parent: Element, values: Sequence[float], form: str = "{!r}") -> None:
    for value in values:
        _add(parent, "V", form.format(value))


def _add(parent: Element, tag: str, text: str) -> Element:
    element = SubElement(parent, tag)
    element.text = on_one_line(text)
    return element


def read(content: bytes, file: str) -> Content:
    """Returns the values of a file; members of structures are called `structure.member`.

    Raises InvalidInputError with the line of the first fault, also for entities, which could blow up or read files.
    """
    root = _parsed(content, file)
    category = _words(root, "CATEGORY")
    if root.tag != "MSRSW" or not category.startswith("CDF2"):
        message = f"it is not a CDF 2 file, but {shown(root.tag)} {shown(category)}"
        raise refused(file, _line(root), message, "export it as CDF 2.0 or 2.1")
    result = Content()
    for node, name in _instances(root, ""):
        result.add(file, name, _characteristic(node, name, file))
    return result


def _parsed(content: bytes, file: str) -> Element:
    """Returns the root. Elements have their lines as the attribute `line`, and the places of their contents as `begin` and `end`."""
    if len(content) > LARGEST_FILE:
        raise refused(file, 0, f"it has more than {LARGEST_FILE >> 20} MB", "give a smaller file")
    parser = expat.ParserCreate()
    parser.buffer_text = True
    document = Element("document")
    path = [document]

    def start(tag: str, _: object) -> None:
        line, begin = str(parser.CurrentLineNumber), str(parser.CurrentByteIndex)
        path.append(SubElement(path[-1], tag.rpartition(":")[2], line=line, begin=begin))
        if len(path) > DEEPEST:
            raise ValueError("its elements are nested too deeply")

    def end(_: str) -> None:
        node, last = path.pop(), parser.CurrentByteIndex
        node.attrib |= {"begin": str(content.find(b">", int(node.attrib["begin"]), last) + 1), "end": str(last)}

    def text(characters: str) -> None:
        if len(path[-1]) == 0:  # what follows a child are blanks
            path[-1].text = f"{path[-1].text or ''}{characters}"

    def refuse(*_: object) -> None:
        raise ValueError("entities are not supported")

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, end, text
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        reason = expat.ErrorString(error.code) if isinstance(error, expat.ExpatError) else str(error)
        raise refused(file, parser.CurrentLineNumber, f"the XML cannot be read: {reason}", "export it again") from error
    return document[0]


def _instances(node: Element, prefix: str) -> Iterator[tuple[Element, str]]:
    """Yields the instances without members of their own, with their names."""
    for child in node:
        if child.tag != "SW-INSTANCE":
            yield from _instances(child, prefix)
            continue
        own = _words(child, "SHORT-NAME")
        name = f"{prefix}.{own}".removeprefix(".") if own else f"{prefix}[{_words(child, 'SW-ARRAY-INDEX')}]"
        if child.find("SW-INSTANCE") is not None:
            yield from _instances(child, name)
        else:
            yield child, name


def _characteristic(node: Element, name: str, file: str) -> Characteristic | None:
    """Returns a characteristic, or None if the instance is something else, or has no value or several variants."""
    holders = [node] if node.find("SW-VALUE-CONT") is not None else node.findall("SW-INSTANCE-PROPS-VARIANTS/*")
    held = [container for holder in holders for container in holder.findall("SW-VALUE-CONT")]
    category = _words(node, "CATEGORY")
    kind = "VALUE" if category in SCALARS else _KINDS.get(category, "")
    own = held[0].find("SW-VALUES-PHYS") if len(held) == 1 else None
    groups = [] if own is None else own.findall("VG") or [own]
    rows = [[cell for cell in group if cell.tag != "LABEL"] for group in groups]
    cells = [cell for row in rows for cell in row]
    known = {"V", "VF"} if kind != "VALUE" else {"V", "VF", "VT"}
    if not kind or not cells or any(cell.tag not in known for cell in cells) or (kind == "VALUE" and len(cells) > 1):
        return None
    if not name:
        raise refused(file, _line(node), "an instance has no SHORT-NAME", "give it a name")
    numbers, fault = _read_numbers([cell for cell in cells if cell.tag != "VT"], file)
    said = unit_of(_words(held[0], "UNIT-DISPLAY-NAME")), _words(node, "LONG-NAME")
    read = Characteristic(name, None, *said, line=_line(node), kind=kind, places=_places(cells))
    if kind == "VALUE":
        value = numbers[0] if numbers else (cells[0].text or "").strip()
        is_truth = category == "BOOLEAN" and value in {*TRUTHS, *CODES}
        return replace(read, value=value, fault=fault, choices=TRUTHS if is_truth else (), codes=CODES if is_truth else ())
    sizes = [len(rows[0]), len(rows)] if kind == "MAP" or len(rows) > 1 else [len(rows[0])]
    sizes = extents(sizes) if kind == "VAL_BLK" else sizes
    described = [axis for holder in holders for axis in holder.findall("SW-AXIS-CONTS/SW-AXIS-CONT")]
    ordered = sorted(enumerate(described, 1), key=lambda pair: _words(pair[1], "SW-AXIS-INDEX") or str(pair[0]))  # x is 1
    axes = [_axis(axis, size, file) for (_, axis), size in zip(ordered, sizes, strict=False)]
    axes = axes if kind in {"CURVE", "MAP"} else list(map(index, sizes))
    if len(described) > len(axes) or len(axes) != len(sizes) or not all(axis.kind in _AXES for axis in axes):
        return None
    if len(cells) != math.prod(sizes) or any(len(axis.points) not in {0, size} for axis, size in zip(axes, sizes, strict=True)):
        fault = problem_of(file, _line(node), f"{shown(name)} has not a value for each point of its axes", "export it again")
    return replace(read, axes=tuple(axes), values=numbers, fault=fault)


def _axis(node: Element, size: int, file: str) -> Axis:
    """Returns an axis; that of a table of positions is an index if the file has no points of it."""
    kind = _words(node, "CATEGORY") or "COM_AXIS"
    cells = node.findall("SW-VALUES-PHYS/*")
    points, fault = _read_numbers([cell for cell in cells if cell.tag in {"V", "VF"}], file)
    own = Axis(kind, () if fault else points, places=_places(cells))
    axis = index(size, kind) if kind == "RES_AXIS" and not cells else own
    return replace(axis, unit=unit_of(_words(node, "UNIT-DISPLAY-NAME")), shared=_words(node, "SW-INSTANCE-REF"))


def _words(node: Element, path: str) -> str:
    return " ".join((node.findtext(path) or "").split())


def _line(node: Element) -> int:
    return int(node.attrib["line"])


def _places(cells: Sequence[Element]) -> Places:
    return tuple((int(cell.attrib["begin"]), int(cell.attrib["end"])) for cell in cells)


def _read_numbers(cells: Sequence[Element], file: str) -> tuple[tuple[float, ...], Problem | None]:
    read = [number_or_fault((cell.text or "").strip(), _line(cell), file) for cell in cells]
    return tuple(value for value, _ in read), next((fault for _, fault in read if fault is not None), None)
