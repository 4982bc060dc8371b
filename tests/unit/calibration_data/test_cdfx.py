"""CDF 2.x: values survive, quality data is where tools look for it, hostile XML is refused with its line."""

from xml.etree import ElementTree as ET

import pytest
from tests.support.values import faulty_fields, present
from tests.unit.calibration_data.test_curves import QUALITY

from drivecal.calibration_data import cdfx
from drivecal.calibration_data.characteristics import Characteristic


def test_values_and_history_are_where_other_tools_look_for_them() -> None:
    root = ET.fromstring(cdfx.write([Characteristic("P", 1 / 7e5)], QUALITY, "set"))
    (instance,) = root.findall("./SW-SYSTEMS/SW-SYSTEM/SW-INSTANCE-SPEC/SW-INSTANCE-TREE/SW-INSTANCE")
    value, kind = instance.findtext("SW-VALUE-CONT/SW-VALUES-PHYS/V", ""), instance.findtext("CATEGORY")
    assert (float(value), kind) == (1 / 7e5, "VALUE")
    entry = present(instance.find("SW-CS-HISTORY/CS-ENTRY"))
    assert [child.tag for child in entry] == ["STATE", "DATE", "CSUS", "CSPR", "CSWP", "CSTO", "CSPI", "CSDI", "SD"]
    assert (entry.findtext("STATE"), entry.findtext("CSPI")) == ("calibrated", "c" * 32)
    assert [(figure.get("GID"), figure.text) for figure in entry.findall("SD")] == [("score city", "6")]


def document(inside: str, head: str = "", category: str = "CDF20") -> bytes:
    return f"""<?xml version="1.0" encoding="ISO-8859-1"?>
{head}<MSRSW xmlns="http://www.asam.net/xml"><SHORT-NAME>a</SHORT-NAME><CATEGORY>{category}</CATEGORY>
<SW-SYSTEMS><SW-SYSTEM><SW-INSTANCE-SPEC><SW-INSTANCE-TREE>
{inside}
</SW-INSTANCE-TREE></SW-INSTANCE-SPEC></SW-SYSTEM></SW-SYSTEMS></MSRSW>""".encode("latin-1")


def instance(name: str, value: str, category: str = "VALUE", around: str = "{}") -> str:
    held = f"<SW-VALUE-CONT><UNIT-DISPLAY-NAME>°</UNIT-DISPLAY-NAME><SW-VALUES-PHYS>{value}</SW-VALUES-PHYS></SW-VALUE-CONT>"
    return f"<SW-INSTANCE><SHORT-NAME>{name}</SHORT-NAME><CATEGORY>{category}</CATEGORY>{around.format(held)}</SW-INSTANCE>"


def test_axes_are_ordered_by_their_index() -> None:
    axis = "<SW-AXIS-CONT><CATEGORY>STD_AXIS</CATEGORY><SW-AXIS-INDEX>{}</SW-AXIS-INDEX><SW-VALUES-PHYS>{}</SW-VALUES-PHYS></SW-AXIS-CONT>"
    y, x = axis.format(2, "<V>10</V><V>20</V>"), axis.format(1, "<V>1</V><V>2</V>")
    held = instance("m", "<VG><V>5</V><V>6</V></VG>" * 2, "MAP", f"{{}}<SW-AXIS-CONTS>{y}{x}</SW-AXIS-CONTS>")
    (read,) = cdfx.read(document(held), "a.cdfx").characteristics
    assert [axis.points for axis in read.axes] == [(1.0, 2.0), (10.0, 20.0)]


VARIANT = "<SW-INSTANCE-PROPS-VARIANT>{}</SW-INSTANCE-PROPS-VARIANT>"


def test_structures_variants_and_truths_are_read_and_texts_left_out() -> None:
    read = cdfx.read(
        document(
            instance("a", "<V>1.5</V>")
            + instance("b", "<VT>true</VT>", "BOOLEAN", f"<SW-INSTANCE-PROPS-VARIANTS>{VARIANT}</SW-INSTANCE-PROPS-VARIANTS>")
            + instance("c", "<VG><V>1</V><VT>2</VT></VG>", "VAL_BLK")
            + instance(
                "d",
                "<V>1</V>",
                "VALUE",
                f"<SW-INSTANCE-PROPS-VARIANTS>{VARIANT * 2}</SW-INSTANCE-PROPS-VARIANTS>".replace("{}", "{0}"),
            )
            + f"<SW-INSTANCE><SHORT-NAME>s</SHORT-NAME><CATEGORY>STRUCTURE</CATEGORY>{instance('e', '<V>2</V>')}</SW-INSTANCE>",
            cdfx.DOCTYPE,
        ),
        "a.cdfx",
    )
    assert [(row.name, row.value, row.unit, row.choices) for row in read.characteristics] == [
        ("a", 1.5, "°", ()),
        ("b", "true", "°", ("false", "true")),
        ("s.e", 2.0, "°", ()),
    ]
    assert read.skipped == ["c", "d"]


def test_members_of_arrays_have_the_names_of_an_a2l_and_truths_their_category() -> None:
    member = f"<SW-INSTANCE><SW-ARRAY-INDEX>0</SW-ARRAY-INDEX>{instance('x', '<V>2</V>')}</SW-INSTANCE>"
    array = f"<SW-INSTANCE><SHORT-NAME>arr</SHORT-NAME><CATEGORY>STRUCTURE_ARRAY</CATEGORY>{member}</SW-INSTANCE>"
    read = cdfx.read(document(array + instance("on", "<V>1</V>", "BOOLEAN")), "a.cdfx").characteristics
    assert [(row.name, row.value, row.choices) for row in read] == [("arr[0].x", 2.0, ()), ("on", 1.0, ("false", "true"))]
    written = cdfx.write([Characteristic("on", "true", choices=("false", "true"))])
    assert b"<CATEGORY>BOOLEAN</CATEGORY>" in written
    assert cdfx.read(written, "a.cdfx").characteristics[0].choices == ("false", "true")


@pytest.mark.parametrize(
    ("file", "line"),
    [
        (b"", 1),
        (b"<MSRSW>\n<a></MSRSW>", 2),
        (document("", category="CDF10"), 2),
        (b"<A/>", 1),
        (document("", '<!DOCTYPE MSRSW [<!ENTITY a "b">]>'), 2),
        (document("", '<!DOCTYPE MSRSW [<!ENTITY a SYSTEM "file:///etc/passwd">]>'), 2),
        (document(instance("a", "<V>x</V>")), 4),
        (document(instance("a", "<V>1</V>") + "\n" + instance("a", "<V>1</V>")), 5),
        (b"<x>" * 10_000, 1),
    ],
)
def test_the_first_fault_is_named_with_its_line(file: bytes, line: int) -> None:
    assert faulty_fields(cdfx.read, file, "a.cdfx") == [f"a.cdfx, line {line}"]
