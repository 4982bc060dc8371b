"""DCM 2.0: what is written is read again without loss, by drivecal and by dcmReader; faults are named with their line."""

import contextlib
import string
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.logs import log_left_as_it_was

from drivecal.calibration_data import dcm
from drivecal.calibration_data.characteristics import Characteristic, Quality
from drivecal.domain.errors import InvalidInputError

PUBLIC = Path(__file__).parent / "public" / "DEMO.DCM"
"""Written by CDM 7.2.3, from https://github.com/zhyongquan/pydcm; the folder holds its licence."""
QUALITY = Quality(
    "calibrated", "2026-11-21T10:00:00+00:00", "highway", "comfort", "frenet", "0" * 32, figures=(("score S1", "6"),)
)
names = st.text(string.ascii_letters + string.digits + "_.", min_size=1, max_size=40)
texts = st.text(
    st.characters(codec="utf-8", exclude_categories=("C", "Zl", "Zp", "Zs"), exclude_characters='"'), min_size=1, max_size=40
)
numbers = st.floats(allow_nan=False, allow_infinity=False)
characteristics = st.lists(
    st.builds(
        Characteristic,
        name=names,
        value=numbers | texts,
        unit=texts.filter(lambda text: text not in {"-", "1"}) | st.just("1"),
        description=texts | st.just(""),
    ),
    max_size=20,
    unique_by=lambda characteristic: characteristic.name,
)


def content(characteristic: Characteristic) -> tuple[object, ...]:
    return characteristic.name, characteristic.value, characteristic.unit, characteristic.description


@given(characteristics)
def test_nothing_is_lost_on_the_way_through_a_file(given: list[Characteristic]) -> None:
    file = dcm.write(given, QUALITY)
    assert list(map(content, dcm.read(file, "a.dcm").characteristics)) == list(map(content, given))
    assert dcm.write(dcm.read(file, "a.dcm").characteristics, QUALITY) == file


def test_a_thousand_numbers_keep_all_their_bits_in_another_reader(tmp_path: Path) -> None:
    given = [Characteristic(f"P_{index}", (index - 500) / 7e5, "m/s", f"number {index}") for index in range(1000)]
    file = tmp_path / "many.dcm"
    file.write_bytes(dcm.write(given, QUALITY))
    with log_left_as_it_was():  # importing it sets up the log of the process
        from dcmReader.dcm_reader import DcmReader
    other = DcmReader()
    other.read(str(file))
    assert [(row.name, row.value, row.unit, row.description) for row in other.get_parameters()] == list(map(content, given))
    written = tmp_path / "theirs.dcm"
    other.write(str(written), sort_entries=False)
    assert list(map(content, dcm.read(written.read_bytes(), "theirs.dcm").characteristics)) == list(map(content, given))


def test_another_reader_has_the_same_scalars_of_a_public_file() -> None:
    with log_left_as_it_was():
        from dcmReader.dcm_reader import DcmReader
    other = DcmReader()
    other.read(str(PUBLIC))
    read = dcm.read(PUBLIC.read_bytes(), PUBLIC.name)
    assert list(map(content, read.characteristics)) == [
        (row.name, row.value, row.unit, row.description) for row in other.get_parameters()
    ]
    lists = (other.get_characteristic_lines(), other.get_characteristic_maps(), other.get_fixed_characteristic_lines())
    others = [name for rows in lists for name in (row.name for row in rows)]
    assert (len(read.characteristics), sorted(read.skipped)) == (2, sorted(others))


def test_other_kinds_are_listed_and_left_out() -> None:
    text = """* made by hand
KONSERVIERUNG_FORMAT 2.0
FUNKTIONEN
  FKT ACC "1.0" "Adaptive cruise control"
END
KENNLINIE Curve 2
   EINHEIT_X "m"
   ST/X 0.0 1.0
   WERT 3.0 4.0
END
FESTWERT Gap
! a comment inside
   LANGNAME "Time gap"
   FUNKTION "ACC"
   EINHEIT_W "s"
   WERT 1.5
END
FESTWERT Sporty
   WERT 1.5
   VAR Sport=1.1
END
FESTWERT Mode
   EINHEIT_W "-"
   TEXT "eco"
END
"""
    read = dcm.read(text.encode("latin-1"), "a.dcm")
    assert read.skipped == ["Curve", "Sporty"]
    assert [(row.name, row.value, row.unit, row.line) for row in read.characteristics] == [
        ("Gap", 1.5, "s", 11),
        ("Mode", "eco", "1", 22),
    ]


def test_the_first_parameter_follows_the_heads_of_modules() -> None:
    text = """KONSERVIERUNG_FORMAT 2.0
MODULKOPF "ACC" "Adaptive cruise control"
MODULKOPF "version 3"
FESTWERT Gap
   WERT 1.5
END
FESTWERT Mode
   TEXT "eco"
END
"""
    read = dcm.read(text.encode(), "a.dcm")
    assert [(row.name, row.value, row.line) for row in read.characteristics] == [("Gap", 1.5, 4), ("Mode", "eco", 7)]


@pytest.mark.parametrize("written", ['the "fast" gain', r"the \"fast\" gain", 'the ""fast"" gain'])
def test_quotes_inside_a_string_are_read_as_tools_write_them(written: str) -> None:
    text = f'KONSERVIERUNG_FORMAT 2.0\nFESTWERT a\n  LANGNAME "{written}"\n  WERT 1\nEND\n'
    assert dcm.read(text.encode(), "a.dcm").characteristics[0].description == 'the "fast" gain'


def test_a_value_that_is_not_finite_concerns_its_own_parameter_only() -> None:
    text = "KONSERVIERUNG_FORMAT 2.0\nFESTWERT a\n  WERT NaN\nEND\nFESTWERT b\n  WERT 1\nEND\n"
    first, second = dcm.read(text.encode(), "a.dcm").characteristics
    assert first.fault is not None
    assert (first.fault.field, second.fault) == ("a.dcm, line 3", None)


def test_separators_of_unicode_and_older_encodings_are_no_line_ends() -> None:
    text = 'KONSERVIERUNG_FORMAT 2.0\nFESTWERT a\n  LANGNAME "up to\u2026 \u20ac"\n  WERT 1\nEND\nFESTWERT b\n  WERT x\nEND\n'
    with pytest.raises(InvalidInputError) as refused:
        dcm.read(text.encode("cp1252"), "a.dcm")
    assert [problem.field for problem in refused.value.problems] == ["a.dcm, line 7"]
    read = dcm.read(text.replace("WERT x", "WERT 2").encode("cp1252"), "a.dcm")
    assert read.characteristics[0].description == "up to\u2026 \u20ac"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", 1),
        ("FESTWERT a\nEND\n", 1),
        ("KONSERVIERUNG_FORMAT 1.0\n", 1),
        ("KONSERVIERUNG_FORMAT 2.0\nFESTWERT a\n  WERT 1\n", 2),
        ("KONSERVIERUNG_FORMAT 2.0\nFESTWERT a\n  WERT 1,5\nEND\n", 3),
        ("KONSERVIERUNG_FORMAT 2.0\nFESTWERT a\n  WERT 1\n  WERT 2\nEND\n", 4),
        ("KONSERVIERUNG_FORMAT 2.0\nFESTWERT a\n  LANGNAME open\nEND\n", 3),
        ("KONSERVIERUNG_FORMAT 2.0\nFESTWERT a\n  WERT 1\nEND\nFESTWERT a\n  WERT 1\nEND\n", 5),
        ("KONSERVIERUNG_FORMAT 2.0\nFESTWERT\nEND\n", 2),
        ("KONSERVIERUNG_FORMAT 2.0\nUNSINN a\n", 2),
        ("KONSERVIERUNG_FORMAT 2.0\nKENNFELD a 2 2\n  WERT 1 2\n", 2),
    ],
)
def test_the_first_fault_is_named_with_its_line(text: str, line: int) -> None:
    with pytest.raises(InvalidInputError) as refused:
        dcm.read(text.encode(), "a.dcm")
    assert [problem.field for problem in refused.value.problems] == [f"a.dcm, line {line}"]
    assert all(problem.remedy for problem in refused.value.problems)


@given(st.binary(max_size=200).map(lambda tail: b"KONSERVIERUNG_FORMAT 2.0\n" + tail))
def test_any_bytes_are_read_or_refused(file: bytes) -> None:
    with contextlib.suppress(InvalidInputError):
        assert dcm.read(file, "a.dcm").characteristics is not None
