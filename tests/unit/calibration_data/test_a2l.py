"""A2L: limits, units, resolutions and enumerations of scalar characteristics; faults are named with their line."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import faults_of, faulty_fields, present

from drivecal.calibration_data import a2l
from drivecal.calibration_data.characteristics import Characteristic
from drivecal.calibration_data.sections import joined, sections_of
from drivecal.domain.errors import InvalidInputError

HEAD = """ASAP2_VERSION 1 71 /* a comment
over two lines */
/begin PROJECT acc "A project with ""quotes"" and \\"more\\""
/begin MODULE m ""
/begin MOD_COMMON "" BYTE_ORDER MSB_LAST /end MOD_COMMON
"""
TAIL = """
/begin RECORD_LAYOUT _U16 FNC_VALUES 1 UWORD ROW_DIR DIRECT /end RECORD_LAYOUT
/begin RECORD_LAYOUT _F32 FNC_VALUES 1 FLOAT32_IEEE ROW_DIR DIRECT /end RECORD_LAYOUT
/begin COMPU_METHOD speed "" RAT_FUNC "%8.3" "m/s" COEFFS 0 80 0 0 0 1 /end COMPU_METHOD
/begin COMPU_METHOD gap "" LINEAR "%8.3" "s" COEFFS_LINEAR 0.01 0 /end COMPU_METHOD
/begin COMPU_METHOD fifths "" LINEAR "%8.3" "" COEFFS_LINEAR 0.2 0 /end COMPU_METHOD
/begin COMPU_METHOD halves "" LINEAR "%8.3" "" COEFFS_LINEAR 1 0.5 /end COMPU_METHOD
/begin COMPU_METHOD same "" IDENTICAL "%8.3" "" /end COMPU_METHOD
/begin COMPU_METHOD modes "" TAB_VERB "%1.0" "" COMPU_TAB_REF modes_t /end COMPU_METHOD
/begin COMPU_METHOD ranges "" TAB_VERB "%1.0" "" COMPU_TAB_REF ranges_t /end COMPU_METHOD
/begin COMPU_METHOD orphan "" TAB_VERB "%1.0" "" COMPU_TAB_REF none_t /end COMPU_METHOD
/begin COMPU_METHOD table "" TAB_INTP "%1.0" "" COMPU_TAB_REF numbers_t /end COMPU_METHOD
/begin COMPU_VTAB_RANGE ranges_t "" 4 0 0 "off" 1 1 "on" 2 2 "auto" 3 9 "reserved" DEFAULT_VALUE "none" /end COMPU_VTAB_RANGE
/begin COMPU_VTAB modes_t "" TAB_VERB 3 0 "eco" 1 "normal" 2 "sport" DEFAULT_VALUE "none" /end COMPU_VTAB
/end MODULE
/end PROJECT
"""


def file(*characteristics: str) -> bytes:
    return (HEAD + "\n".join(f"/begin CHARACTERISTIC {text} /end CHARACTERISTIC" for text in characteristics) + TAIL).encode()


def read(*characteristics: str) -> list[Characteristic]:
    return a2l.read(file(*characteristics), "a.a2l").characteristics


def test_limits_units_and_resolutions_are_physical() -> None:
    v0, gap, n, mode, free, bound = read(
        'v0 "Desired /* no comment */ speed" VALUE 0x10 _U16 0 speed 0 60 // a comment "\n',
        'gap "Time gap" VALUE 0x12 _U16 0 gap 0.5 3.0 DISPLAY_IDENTIFIER g',
        'n "" VALUE 0x14 _U16 0 same 1 9',
        'mode "" VALUE 0x16 _U16 0 modes 0 1',
        'free "" VALUE 0x18 _F32 0 gap -1 1 PHYS_UNIT "ms"',
        'bound "" VALUE 0x18 _F32 0 NO_COMPU_METHOD 0 1 STEP_SIZE 0.25',
    )
    assert (v0.name, v0.description, v0.lower, v0.upper, v0.unit, v0.step) == (
        *("v0", "Desired /* no comment */ speed", 0.0, 60.0, "m/s", 0.0125),
    )
    assert (gap.lower, gap.upper, gap.unit, gap.step, gap.integer) == (0.5, 3.0, "s", 0.01, False)
    assert (n.lower, n.upper, n.unit, n.step, n.integer) == (1.0, 9.0, "1", None, True)
    assert (mode.choices, mode.codes, mode.integer, mode.step) == (("eco", "normal"), (0.0, 1.0), False, None)
    assert (free.unit, free.step, free.integer) == ("ms", None, False)
    assert (bound.unit, bound.step) == ("1", 0.25)
    assert v0.line == 6


def test_curves_have_their_axes_and_fixed_points_are_physical() -> None:
    axes = {
        "dist": "FIX_AXIS in speed 3 0 60 FIX_AXIS_PAR_DIST 80 160 3",
        "shift": "FIX_AXIS in same 3 0 60 FIX_AXIS_PAR 4 3 3",
        "listed": "FIX_AXIS in gap 3 0 60 /begin FIX_AXIS_PAR_LIST 100 150 300 /end FIX_AXIS_PAR_LIST",
        "lost": "FIX_AXIS in missing 3 0 60 FIX_AXIS_PAR_DIST 0 1 3",
        "std": 'STD_AXIS in speed 3 -5 60 PHYS_UNIT "km/h"',
        "com": "COM_AXIS in gap 8 0 60 AXIS_PTS_REF shared",
        "res": "RES_AXIS in speed 8 0 60 AXIS_PTS_REF table",
        "bent": "CURVE_AXIS in same 8 0 60 CURVE_AXIS_REF std",
    }
    axes = {name: f"/begin AXIS_DESCR {axis} /end AXIS_DESCR " for name, axis in axes.items()}
    arrays = {"row": "NUMBER 4", "table": "MATRIX_DIM 2 3 1", "cube": "MATRIX_DIM 2 3 2"}
    content = file(
        *(f'{name} "" CURVE 0x10 _U16 0 speed 0 60 {axis}' for name, axis in axes.items()),
        f'both "" MAP 0x10 _F32 0 gap 0 1 {axes["com"]} {axes["dist"]}',
        *(f'{name} "" VAL_BLK 0x10 _U16 0 same 0 9 {sizes}' for name, sizes in arrays.items()),
    ).replace(b"/end MODULE", b"""/begin AXIS_PTS shared "own" 0x20 in _X8 0 speed 8 0 30 /end AXIS_PTS
/begin RECORD_LAYOUT _X8 AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT /end RECORD_LAYOUT /end MODULE""")  # fmt: skip
    read = {each.name: each for each in a2l.read(content, "a.a2l").characteristics}
    assert a2l.read(content, "a.a2l").skipped == ["bent", "cube"]
    points = {"dist": (1.0, 3.0, 5.0), "shift": (4.0, 12.0, 20.0), "listed": (1.0, 1.5, 3.0)}
    assert {name: read[name].axes[0].points for name in axes if name != "bent" and read[name].axes[0].points} == points
    std, com, res = (read[name].axes[0] for name in ("std", "com", "res"))
    assert (std.kind, std.unit, std.lower, std.upper) == ("STD_AXIS", "km/h", -5.0, 60.0)
    assert (com.kind, com.unit, com.shared, res.kind, res.unit) == ("COM_AXIS", "s", "shared", "RES_AXIS", "1")
    assert [axis.kind for axis in read["both"].axes] == ["COM_AXIS", "FIX_AXIS"]
    assert [len(axis.points) for name in ("row", "table") for axis in read[name].axes] == [4, 2, 3]
    shared = read["shared"]
    assert (shared.kind, shared.lower, shared.upper, shared.step, shared.unit) == ("COM_AXIS", 0.0, 30.0, 0.0125, "m/s")


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"", 1),
        (b"/begin A\n/end A", 1),
        (b"/begin PROJECT a\n/end B", 2),
        (b"/begin PROJECT a\n/begin MODULE b", 2),
        (b"/end A", 1),
        (b'/begin PROJECT a\n"open\n/end PROJECT', 2),
        (b'/begin PROJECT a\n/include "other.a2l"\n/end PROJECT', 2),
        (file('a "" VALUE 0x10 _U16 0 speed 0'), 6),
        (file('a "" VALUE 0 _U16 0 speed 0 1', 'a "" VALUE 0 _U16 0 speed 0 1'), 7),
    ],
)
def test_the_first_fault_is_named_with_its_line(content: bytes, line: int) -> None:
    assert faulty_fields(a2l.read, content, "a.a2l") == [f"a.a2l, line {line}"]


def test_a_missing_conversion_concerns_its_own_characteristics_only() -> None:
    good, bad = read('good "" VALUE 0x10 _U16 0 speed 0 1', 'bad "" VALUE 0x12 _U16 0 missing 0 1')
    short = file('bad "" VALUE 0 _U16 0 gap 0 1').replace(b"COEFFS_LINEAR 0.01 0", b"COEFFS_LINEAR 0.01")
    valued = Characteristic("bad", 0.5)
    assert list(sections_of([good], {}, 0.5).parameters) == ["good"]
    for chosen in ([good, bad], joined([[bad], [valued]]), joined([[valued], [bad]])):
        assert faulty_fields(sections_of, chosen, {}, 0.5) == ["a.a2l, line 7"]
    with pytest.raises(InvalidInputError, match="2 numbers after COEFFS_LINEAR"):
        sections_of(a2l.read(short, "a.a2l").characteristics, {}, 0.5)


def test_a_limit_that_is_no_number_concerns_its_own_characteristic_only() -> None:
    good, bad = read('good "" VALUE 0x10 _U16 0 speed 0x0 0xFF', 'bad "" VALUE 0x12 _U16 0 speed zero 1')
    assert (good.lower, good.upper, good.fault) == (0.0, 255.0, None)
    assert present(bad.fault).field == "a.a2l, line 7"


def test_limits_beyond_all_numbers_are_none() -> None:
    (free,) = read('free "" VALUE 0x18 _F32 0 NO_COMPU_METHOD -1.79769313486232E+308 1.79769313486232E+308')
    assert (free.lower, free.upper, free.fault) == (None, None, None)
    (whole,) = read('whole "" VALUE 0x18 _U16 0 gap -1.7976931348623157E308 9')
    assert (whole.upper, whole.step, whole.fault) == (9.0, 0.01, None)


def test_ranges_begin_on_the_raster_of_the_control_unit() -> None:
    coarse, shifted, fine = read(
        'coarse "" VALUE 0x10 _U16 0 fifths 0.5 3.0',
        'shifted "" VALUE 0x10 _U16 0 halves 1 4',
        'fine "" VALUE 0x10 _U16 0 fifths 0.5 3.0 STEP_SIZE 0.25',
    )
    assert coarse.lower == pytest.approx(0.6)
    assert (coarse.step, coarse.integer) == (0.2, False)
    assert (shifted.lower, shifted.step, shifted.integer) == (1.5, 1.0, False)
    assert (fine.lower, fine.step) == (0.5, 0.25)


def test_limits_beyond_the_stored_type_are_noted() -> None:
    within = ["UWORD 0 655.35", "SBYTE -1.28 1.27", "FLOAT32_IEEE -1E9 1E9"]
    for each in [*within, "UWORD -1 655", "UWORD 0 656", "SBYTE -1.3 1"]:
        stored, _, limits = each.partition(" ")
        content = file(f'gap "" VALUE 0x10 _U16 0 gap {limits}').replace(b"1 UWORD", f"1 {stored}".encode())
        (gap,) = a2l.read(content, "a.a2l").characteristics
        assert (gap.fault, stored not in gap.note) == (None, each in within)
    masked = read(*(f'gap{upper} "" VALUE 0x10 _U16 0 gap 0 {upper} BIT_MASK 0x0FF0' for upper in (2.55, 2.57)))
    assert ["8 bits of its BIT_MASK" in each.note for each in masked] == [False, True]


def test_a_step_of_1_makes_no_whole_numbers_of_a_finer_raster() -> None:
    (gap,) = read('gap "" VALUE 0x12 _U16 0 gap 0.5 9.5 STEP_SIZE 1')
    assert (gap.step, gap.integer) == (1.0, False)


def test_what_follows_from_others_or_cannot_be_changed_is_left_out() -> None:
    content = a2l.read(
        file(
            'free "" VALUE 0x10 _U16 0 speed 0 1',
            'fixed "" VALUE 0x10 _U16 0 speed 0 1 READ_ONLY',
            'seen "" VALUE 0x10 _U16 0 speed 0 1 CALIBRATION_ACCESS NO_CALIBRATION',
            'unseen "" VALUE 0x10 _U16 0 speed 0 1 CALIBRATION_ACCESS NOT_IN_MCD_SYSTEM',
            'flashed "READ_ONLY" VALUE 0x10 _U16 0 speed 0 1 CALIBRATION_ACCESS OFFLINE_CALIBRATION',
            'curve "" CURVE 0x10 _U16 0 speed 0 1 /begin AXIS_DESCR COM_AXIS in same 8 0 9 AXIS_PTS_REF points /end AXIS_DESCR',
            'twice "" VALUE 0x10 _U16 0 speed 0 1 /begin DEPENDENT_CHARACTERISTIC "X1*2" free /end DEPENDENT_CHARACTERISTIC',
        ).replace(b"/end MODULE", b"""/begin INSTANCE x "" T 0x10 /end INSTANCE
/begin AXIS_PTS points "" 0x20 in _U16 0 same 8 0 30 CALIBRATION_ACCESS NO_CALIBRATION /end AXIS_PTS /end MODULE"""),
        "a.a2l",
    )  # fmt: skip
    assert [each.name for each in content.characteristics] == ["free", "flashed", "curve"]
    assert content.skipped == ["fixed", "seen", "unseen", "twice", "x", "points"]


def test_an_included_description_of_interfaces_is_ignored() -> None:
    content = file('a "" VALUE 0x10 _U16 0 speed 0 1').replace(b"/begin MOD_", b'/include "XCP_104.aml"\n/begin MOD_')
    assert [each.name for each in a2l.read(content, "a.a2l").characteristics] == ["a"]


def test_ranges_of_one_value_are_choices() -> None:
    (mode,) = read('mode "" VALUE 0x16 _U16 0 ranges 1 2')
    assert (mode.choices, mode.codes, mode.integer, mode.step, mode.fault) == (("on", "auto"), (1.0, 2.0), False, None, None)


def test_a_table_of_numbers_makes_no_choices() -> None:
    (gain,) = read('gain "" VALUE 0x16 _U16 0 table 0 4')
    assert (gain.choices, gain.lower, gain.upper, gain.fault) == ((), 0.0, 4.0, None)


@pytest.mark.parametrize("conversion", ["ranges 0 3", "ranges 4 9", "orphan 0 1", "modes 3 9"])
def test_an_enumeration_that_no_texts_describe_concerns_its_own_characteristic_only(conversion: str) -> None:
    good, bad = read('good "" VALUE 0x10 _U16 0 speed 0 1', f'bad "" VALUE 0x12 _U16 0 {conversion}')
    assert list(sections_of([good], {}, 0.5).parameters) == ["good"]
    refused = faults_of(sections_of, [good, bad], {}, 0.5)
    assert [problem.field for problem in refused] == ["a.a2l, line 7"]
    assert all(problem.remedy for problem in refused)


TOKENS = [
    "/begin", "/end", "PROJECT", "CHARACTERISTIC", "VALUE", '""', '"', "0", "nan", "1e999", "/*", "*/", "COMPU_METHOD", "LINEAR", "\n",
]  # fmt: skip


@given(st.lists(st.sampled_from(TOKENS), max_size=60).map(" ".join))
def test_any_words_are_read_or_refused(text: str) -> None:
    with contextlib.suppress(InvalidInputError):
        assert a2l.read(text.encode(), "a.a2l").skipped is not None


def test_names_are_local_to_their_module() -> None:
    module = """/begin MODULE {0} ""
/begin RECORD_LAYOUT L FNC_VALUES 1 {1} ROW_DIR DIRECT /end RECORD_LAYOUT /begin AXIS_PTS x "" 0 in L 0 M 8 0 9 /end AXIS_PTS
/begin COMPU_METHOD M "" {2} /end COMPU_METHOD /begin COMPU_METHOD E "" TAB_VERB "%1.0" "" COMPU_TAB_REF T /end COMPU_METHOD
/begin COMPU_VTAB T "" TAB_VERB 2 0 "{0} off" 1 "{0} on" /end COMPU_VTAB
/begin CHARACTERISTIC {0}_gap "" VALUE 0 L 0 M 0 100 /end CHARACTERISTIC
/begin CHARACTERISTIC {0}_mode "" VALUE 0 L 0 E 0 1 /end CHARACTERISTIC
/begin CHARACTERISTIC {0}_curve "" CURVE 0 L 0 M 0 9 /begin AXIS_DESCR COM_AXIS in M 8 0 9 AXIS_PTS_REF x /end AXIS_DESCR
/end CHARACTERISTIC /end MODULE
"""
    first = module.format("a", "UWORD", 'LINEAR "%6.2" "m" COEFFS_LINEAR 0.01 0')
    second = module.format("b", "FLOAT32_IEEE", 'IDENTICAL "%6.2" "mm"')
    for modules, ambiguous in ((first + second, "b_curve"), (second + first, "a_curve")):
        read = a2l.read(f'/begin PROJECT p ""\n{modules}/end PROJECT\n'.encode(), "a.a2l").characteristics
        content = {each.name: each for each in read}
        gaps = [(each.unit, each.step, each.integer) for name, each in content.items() if "gap" in name]
        assert sorted(gaps) == [("m", 0.01, False), ("mm", None, False)]
        assert (content["a_mode"].choices, content["b_mode"].choices) == (("a off", "a on"), ("b off", "b on"))
        assert [name for name, each in content.items() if each.fault] == [ambiguous]
