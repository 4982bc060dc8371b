"""Curves, maps, arrays and shared axes in DCM and CDFX: kept to the last bit, also in another reader, and in files that others wrote."""

import math
import re
import string
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.command import log_left_as_it_was
from tests.support.values import faulty_fields

from drivecal.calibration_data import a2l, cdfx, dcm
from drivecal.calibration_data.carried import carried
from drivecal.calibration_data.characteristics import Axis, Characteristic, Quality, index, unit_of
from drivecal.calibration_data.files import CalibrationFormat
from drivecal.calibration_data.sections import joined
from drivecal.domain.errors import InvalidInputError

PUBLIC = Path(__file__).parent / "public" / "DEMO.DCM"
"""Written by CDM 7.2.3, from https://github.com/zhyongquan/pydcm; the folder holds its licence."""
QUALITY = Quality(
    "calibrated", "2026-11-21T10:00:00+00:00", "my-acc", "comfort", "process", "c" * 32, "d" * 64, (("score city", "6"),)
)
FORMS: Mapping[CalibrationFormat, ModuleType] = {"dcm": dcm, "cdfx": cdfx}
numbers = st.floats(allow_nan=False, allow_infinity=False)
names = st.text(string.ascii_letters + string.digits + "_.", min_size=1, max_size=40)
texts = st.text(
    st.characters(codec="utf-8", exclude_categories=("C", "Zl", "Zp", "Zs"), exclude_characters='"'), min_size=1, max_size=40
)
units = texts.filter(lambda text: text not in {"-", "1"}) | st.just("1")


@st.composite
def characteristics(draw: st.DrawFn) -> Characteristic:
    plain = Characteristic(draw(names), draw(numbers | texts), draw(units), draw(texts | st.just("")))
    kind = draw(st.sampled_from(["VALUE", "CURVE", "MAP", "VAL_BLK", "COM_AXIS"]))
    sizes = {"MAP": [3, 4], "VAL_BLK": draw(st.lists(st.integers(2, 5), min_size=1, max_size=2))}.get(kind, [3])
    axes = [index(size) for size in sizes]
    if kind in {"CURVE", "MAP"}:
        axis_kind, shared = draw(st.sampled_from(["STD_AXIS", "FIX_AXIS", "COM_AXIS"])), draw(st.sampled_from(["", "-shared"]))
        points = [sorted(draw(st.sets(numbers, min_size=size, max_size=size))) for size in sizes]
        axes = [Axis(axis_kind, tuple(each), draw(units), shared) for each in points]
    values = draw(st.tuples(*[numbers] * math.prod(sizes)))
    return plain if kind == "VALUE" else replace(plain, value=None, kind=kind, axes=tuple(axes), values=values)


several = st.lists(characteristics(), max_size=5, unique_by=lambda each: each.name)


def plain(each: Characteristic) -> Characteristic:
    return replace(each, line=0, places=(), axes=tuple(replace(axis, places=()) for axis in each.axes))


def in_another_reader(file: Path) -> dict[str, tuple[Any, ...]]:
    """Values (of curves by their points, of maps by y and x, of arrays in rows), units and descriptions in dcmReader."""
    with log_left_as_it_was():  # importing it sets up the log of the process
        from dcmReader.dcm_reader import DcmReader
    other = DcmReader()
    other.read(str(file))
    rows = [row for name in dir(other) if name.startswith("get_") and name != "get_functions" for row in getattr(other, name)()]
    unit = ("unit", "unit_values", "unit_x")
    return {
        row.name: (
            getattr(row, "values", None) or (row.text if row.value is None else row.value),
            unit_of(next(getattr(row, name) for name in unit if hasattr(row, name))),
            row.description or "",
        )
        for row in rows
    }


def expected(each: Characteristic) -> tuple[Any, ...]:
    """The same of a characteristic."""
    values: Any = [list(row) for row in each.rows] if each.kind == "VAL_BLK" else list(each.values) or each.value
    if each.kind in {"CURVE", "MAP"}:
        rows = [dict(zip(each.axes[0].points, row, strict=True)) for row in each.rows]
        values = dict(zip(each.axes[1].points, rows, strict=True)) if each.kind == "MAP" else rows[0]
    return values, each.unit, each.description


@given(several)
def test_another_reader_finds_all_in_a_file(tmp_path_factory: pytest.TempPathFactory, given: list[Characteristic]) -> None:
    for form, module in FORMS.items():
        base = tmp_path_factory.getbasetemp() / f"ours.{form}"
        base.write_bytes(module.write(given, QUALITY))
        read = module.read(base.read_bytes(), base.name).characteristics
        assert list(map(plain, read)) == given
        assert module.write(read, QUALITY) == carried(base, form, read) == base.read_bytes()
        later = module.write(read, replace(QUALITY, campaign="e" * 32, figures=(("rank", "2"), ("a \\1", "b"))))
        assert carried(base, form, read, later) == later, "the origin is that of the later set"
        base.write_bytes(base.read_bytes().replace(b"\r\n", b"\n").replace(b"\n", b"\r\n"))
        crlf = later.replace(b"\r\n", b"\n").replace(b"\n", b"\r\n")
        assert carried(base, form, module.read(base.read_bytes(), base.name).characteristics, later) == crlf
    assert in_another_reader(base.with_suffix(".dcm")) == {each.name: expected(each) for each in given}


def test_another_reader_has_the_same_of_a_public_file_before_and_after_a_change(tmp_path: Path) -> None:
    content = dcm.read(PUBLIC.read_bytes(), PUBLIC.name)
    assert (len(content.characteristics), content.skipped) == (5, [])
    before = {each.name: expected(each) for each in content.characteristics}
    assert in_another_reader(PUBLIC) == before
    curve, table = content.characteristics[2:4]
    changed = [
        replace(curve, values=(0.1, *curve.values[1:])),
        replace(table, axes=(table.axes[0], replace(table.axes[1], points=(0.5, 2.0, 3.0, 4.0, 5.0, 6.0)))),
    ]
    points = Characteristic(f"{table.name}.y", kind="COM_AXIS", values=changed[1].axes[1].points)
    file = tmp_path / "after.dcm"
    file.write_bytes(carried(PUBLIC, "dcm", [changed[0], points]))
    assert in_another_reader(file) == before | {each.name: expected(each) for each in changed}
    assert sum(map(bytes.__ne__, PUBLIC.read_bytes().split(), file.read_bytes().split())) == 7


@pytest.mark.parametrize("form", FORMS)
def test_all_that_was_not_calibrated_stays_in_a_base(tmp_path: Path, form: CalibrationFormat) -> None:
    module, base = FORMS[form], tmp_path / f"b.{form}"
    shared = Characteristic("s", kind="COM_AXIS", axes=(index(2),), values=(1.0, 2.0))
    curve = Characteristic("c", kind="CURVE", axes=(Axis("COM_AXIS", (1.0, 2.0), "m", "s"),), values=(5.0, 6.0))
    content = module.write([shared, curve, Characteristic("mode", "eco"), Characteristic("v", 1.0)]).replace(b"6.0", b"6.000")
    texts = {"dcm": b"VARIANTENKODIERUNG\r\n anything \xe4\r\nEND\r\n", "cdfx": b"<!-- anything \xc3\xa4 -->\n"}
    base.write_bytes(content + texts[form])
    chosen = [replace(shared, values=(1.0, 3.0)), replace(curve, values=(7.0, 6.0)), Characteristic("mode", "a & b")]
    changed = carried(base, form, chosen)
    assert texts[form] in changed
    assert b"6.000" in changed
    read = {each.name: each for each in module.read(changed, f"b.{form}").characteristics}
    assert (read["s"].given, read["c"].given, read["c"].axes[0].points) == ([1.0, 3.0], [7.0, 6.0], (1.0, 3.0))
    assert (read["mode"].value, read["v"].value) == ("a & b", 1.0)
    other: CalibrationFormat = "cdfx" if form == "dcm" else "dcm"
    rewritten = FORMS[other].read(carried(base, other, chosen), f"b.{other}").characteristics
    assert list(map(plain, rewritten)) == [plain(replace(read[each.name], places=())) for each in rewritten]
    moved, short = replace(curve, axes=(Axis("STD_AXIS", (1.0, 9.0)),)), replace(curve, values=(1.0,))
    points = Characteristic("c.x", kind="COM_AXIS", values=(1.0,))
    for faulty in (moved, short, points, Characteristic("mode", 1.0), replace(curve, name="w")):
        assert faulty_fields(carried, base, form, [faulty]) == [faulty.name.removesuffix(".x")]
    base.write_bytes(changed)
    back = {each.name: each for each in module.read(carried(base, form, [shared, curve]), base.name).characteristics}
    assert (back["s"].given, back["c"].axes[0].points) == ([1.0, 2.0], (1.0, 2.0)), "axes that are parameters have moved"


@pytest.mark.parametrize("sizes", ["5", "1 @ 5", "5 @ 1"])
@pytest.mark.parametrize("dimensions", ["5", "1 5 1", "5 1", "1 1 5"])
def test_an_array_has_one_axis_whichever_sizes_of_1_its_files_have(sizes: str, dimensions: str) -> None:
    described = f"""/begin PROJECT p "" /begin CHARACTERISTIC c "" VAL_BLK 0 L 0 NO_COMPU_METHOD 0 9 MATRIX_DIM {dimensions}
/end CHARACTERISTIC /end PROJECT"""
    values = f"KONSERVIERUNG_FORMAT 2.0\nFESTWERTEBLOCK c {sizes}\n  WERT 1 2 3 4 5\nEND\n"
    table = Characteristic("c", kind="VAL_BLK", axes=(index(1), index(5)), values=(1.0, 2.0, 3.0, 4.0, 5.0))
    held = [dcm.read(values.encode(), "v.dcm"), cdfx.read(cdfx.write([table]), "v.cdfx")]
    (array,) = joined(each.characteristics for each in [a2l.read(described.encode(), "d.a2l"), *held])
    assert (array.fault, array.axes, array.given) == (None, (index(5),), [1.0, 2.0, 3.0, 4.0, 5.0])


@pytest.mark.parametrize(("held", "chosen", "made"), [(b"0", "true", b"1"), (b"1", "true", b"1"), (b"1.0", "false", b"0.0")])
def test_a_choice_that_a_base_has_as_a_number_stays_one(tmp_path: Path, held: bytes, chosen: str, made: bytes) -> None:
    base = tmp_path / "b.cdfx"
    written = cdfx.write([Characteristic("flag", 7.0, choices=cdfx.TRUTHS)])
    base.write_bytes(written.replace(b"<V>7.0", b"<V>" + held))
    flag = Characteristic("flag", chosen, choices=cdfx.TRUTHS)
    assert carried(base, "cdfx", [flag]) == written.replace(b"<V>7.0", b"<V>" + made)
    assert [each.given for each in dcm.read(carried(base, "dcm", [flag]), "b.dcm").characteristics] == [float(made)]


@pytest.mark.parametrize("form", FORMS)
def test_a_base_keeps_the_form_of_whole_numbers_and_refuses_other_units(tmp_path: Path, form: CalibrationFormat) -> None:
    base, speed = tmp_path / f"b.{form}", Characteristic("v", 10.0, "m/s²")
    base.write_bytes(FORMS[form].write([replace(speed, value=7)]))
    assert carried(base, form, [speed]) == FORMS[form].write([replace(speed, value=10)])
    table = Characteristic("c", None, "m/s²", kind="CURVE", axes=(Axis("STD_AXIS", (1.0, 2.0), "µm"),), values=(5.0, 6.0))
    for held in (replace(speed, unit="km/h²"), replace(table, axes=(replace(table.axes[0], unit="nm"),))):
        base.write_bytes(FORMS[form].write([held]))
        assert faulty_fields(carried, base, form, [speed if held.name == "v" else table]) == [held.name]
    other = [
        Characteristic("turn", 7.0, "U/min"),
        Characteristic("Größe", 1.0, "µm"),
        Characteristic("mode", "2", choices=("2", "3.0")),
    ]
    base.write_bytes(FORMS[form].write(other))
    chosen = [replace(other[0], value=8.0, unit="rpm"), replace(other[2], value="3.0")]
    assert carried(base, form, chosen) == FORMS[form].write([replace(other[0], value=8.0), other[1], chosen[1]])
    with pytest.raises(InvalidInputError, match=r"give a base that has it"):
        carried(base, form, [*chosen, other[1], Characteristic("turns", 1.0)])


def test_the_history_of_what_another_campaign_calibrated_stays(tmp_path: Path) -> None:
    base, later = tmp_path / "b.cdfx", replace(QUALITY, campaign="e" * 32)
    first, second = Characteristic("a", 1.0), Characteristic("b", 2.0)
    for line in (b"\n", b""):
        base.write_bytes(cdfx.write([first, second], QUALITY).replace(b"\n", line))
        made = carried(base, "cdfx", [replace(first, value=5.0)], cdfx.write([first], later))
        assert re.findall(rb"<CSPI>(.*?)</CSPI>", made) == [later.campaign.encode(), QUALITY.campaign.encode()]
        assert re.findall(rb"<V>(.*?)</V>", made) == [b"5.0", b"2.0"]


@pytest.mark.parametrize("form", FORMS)
def test_a_base_with_the_number_of_an_unknown_choice_is_refused(tmp_path: Path, form: CalibrationFormat) -> None:
    base = tmp_path / f"b.{form}"
    base.write_bytes(FORMS[form].write([Characteristic("mode", 1.0)]))
    with pytest.raises(InvalidInputError, match=r"mode: .*number of a choice, and no text; give .*TEXT"):
        carried(base, form, [Characteristic("mode", "auto", choices=("off", "auto"))])


def test_a_base_of_another_encoding_takes_no_text_that_its_readers_would_misread(tmp_path: Path) -> None:
    base = tmp_path / "b.dcm"
    for encoding in ("utf-8", "cp1252"):
        base.write_bytes(dcm.write([Characteristic("mode", "mild", description="Länge")]).decode().encode(encoding))
        assert b'"wild"' in carried(base, "dcm", [Characteristic("mode", "wild")])
        if encoding == "utf-8":
            assert '"groß"'.encode() in carried(base, "dcm", [Characteristic("mode", "groß")])
    with pytest.raises(InvalidInputError, match="UTF-8"):
        carried(base, "dcm", [Characteristic("mode", "groß")])


def test_an_a2l_gives_the_axes_of_a_set_their_kinds(tmp_path: Path) -> None:
    base = tmp_path / "a.a2l"
    base.write_text("""/begin PROJECT p "" /begin CHARACTERISTIC gap "" CURVE 0 L 0 NO_COMPU_METHOD 0 9
/begin AXIS_DESCR COM_AXIS in NO_COMPU_METHOD 8 0 9 AXIS_PTS_REF speeds /end AXIS_DESCR /end CHARACTERISTIC /end PROJECT""")
    axis = Axis("STD_AXIS", (1.0, 2.0))
    chosen = Characteristic("gap", kind="CURVE", axes=(axis,), values=(5.0, 6.0))
    for form, module in FORMS.items():
        (read,) = module.read(carried(base, form, [chosen]), "set").characteristics
        assert plain(read) == replace(chosen, axes=(replace(axis, kind="COM_AXIS", shared="speeds"),))


def test_a_base_that_refers_to_its_shared_axes_is_written_in_another_format(tmp_path: Path) -> None:
    shared = [Characteristic(name, kind="COM_AXIS", axes=(index(2),), values=(1.0, 2.0)) for name in ("ax", "ay")]
    axes = tuple(Axis("COM_AXIS", each.values, shared=each.name) for each in shared)
    table = Characteristic("m", kind="MAP", axes=axes, values=(1.0, 2.0, 3.0, 4.0))
    base = tmp_path / "b.cdfx"
    for held, chosen, expected in (([*shared, table], [], [*shared, table]), ([table], [table], [table]), ([table], [], [])):
        content = re.sub(rb"(?s)(-REF>a.</SW-INSTANCE-REF>\s*)<SW-VALUES-PHYS>.*?</SW-VALUES-PHYS>", rb"\1", cdfx.write(held))
        base.write_bytes(content)
        assert list(map(plain, dcm.read(carried(base, "dcm", chosen), "b.dcm").characteristics)) == expected
