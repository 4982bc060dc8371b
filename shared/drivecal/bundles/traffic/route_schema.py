"""The schema of route files that SUMO ships: it knows which values each attribute takes."""

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any
from xml.etree import ElementTree as ET

from drivecal.bundles.traffic.elements import Element
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import Problem

_TYPE = re.compile(r"(?:atomic|union) type '(?:xs:)?(\w+)'")
_PREFIX = re.compile(r"^Element '[^']*'(?:, |: )|\[facet '\w+'\] ")
_FLOAT = re.compile(r"\[-\+\]\?\(\(.*?INF\)", re.IGNORECASE)


def faults(root: ET.Element, elements: Sequence[Element]) -> Iterator[Problem]:
    """Yields what the schema refuses in a document that was made of `elements`, in their order; nothing where it is not installed."""
    etree, validator, types = _schema()
    if etree is None:
        return
    document = etree.fromstring(ET.tostring(root))
    validator.validate(document)
    places = dict(zip(document.iter(), elements, strict=True))
    for error in validator.error_log:  # SUMO takes elements in any order
        if error.type_name != "SCHEMAV_ELEMENT_CONTENT" and (element := places.pop(document.xpath(error.path)[0], None)):
            kind = _TYPE.search(error.message)
            right = " or ".join(dict.fromkeys(_right(types, kind[1]))) if kind is not None else "a value that is allowed"
            yield from element.fault(
                shown(_FLOAT.sub("NUMBER", _PREFIX.sub("", error.message)), 400).rstrip("."), f"give {right}"
            ).problems


def _right(types: Mapping[str, Any], name: str) -> Iterator[str]:
    """Yields what a type of the schema takes, in words."""
    if name not in types:
        yield "a whole number" if "int" in name.lower() else "a number"
        return
    for part in types[name].iter():
        for base in (part.get("memberTypes") or part.get("base") or "").split():
            yield from _right(types, base.removeprefix("xsd:")) if base != "xsd:string" else ()
        if part.tag.endswith(("}enumeration", "}pattern")):
            yield _FLOAT.sub("NUMBER", part.get("value")).replace("\\", "")


@cache
def _schema() -> tuple[Any, Any, Mapping[str, Any]]:
    """Returns lxml's module, the schema, and its simple types by name; None in their places where they are not installed."""
    try:
        from lxml import etree  # the installation of a client alone does not have it

        folder = files("sumo_data") / "data" / "xsd"
        parts = [etree.parse(str(folder / "types" / name)) for name in ("base.xsd", "route.xsd")]
        types = {kind.get("name"): kind for part in parts for kind in part.iter("{*}simpleType") if kind.get("name")}
        return etree, etree.XMLSchema(etree.parse(str(folder / "routes_file.xsd"))), types
    except (ImportError, OSError):
        return None, None, {}
