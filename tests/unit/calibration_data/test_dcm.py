"""DCM 2.0: what tools write is read, faults are named with their line. Round trips are in `test_curves.py`."""

import contextlib
from types import ModuleType

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import faults_of, faulty_fields, present

from drivecal.calibration_data import cdfx, dcm
from drivecal.calibration_data.characteristics import Characteristic
from drivecal.domain.errors import InvalidInputError


def test_other_kinds_are_listed_and_left_out() -> None:
    text = """* made by hand
KONSERVIERUNG_FORMAT 2.0
FUNKTIONEN
  FKT ACC "1.0" "Adaptive cruise control"
END
TEXTSTRING Curve
   TEXT "a"
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
        ("Gap", 1.5, "s", 9),
        ("Mode", "eco", "1", 20),
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


@pytest.mark.parametrize("module", [dcm, cdfx])
def test_a_choice_comes_back_with_its_quotes_and_blanks(module: ModuleType) -> None:
    written = module.write([Characteristic("mode", 'say  "x"', "1", "")])
    assert [each.value for each in module.read(written, "a").characteristics] == ['say  "x"']


def test_a_value_that_is_not_finite_concerns_its_own_parameter_only() -> None:
    text = "KONSERVIERUNG_FORMAT 2.0\nFESTWERT a\n  WERT NaN\nEND\nFESTWERT b\n  WERT 1\nEND\n"
    first, second = dcm.read(text.encode(), "a.dcm").characteristics
    assert (present(first.fault).field, second.fault) == ("a.dcm, line 3", None)


def test_separators_of_unicode_and_older_encodings_are_no_line_ends() -> None:
    text = 'KONSERVIERUNG_FORMAT 2.0\nFESTWERT a\n  LANGNAME "up to\u2026 \u20ac"\n  WERT 1\nEND\nFESTWERT b\n  WERT x\nEND\n'
    assert faulty_fields(dcm.read, text.encode("cp1252"), "a.dcm") == ["a.dcm, line 7"]
    read = dcm.read(text.replace("WERT x", "WERT 2").encode("cp1252"), "a.dcm")
    assert read.characteristics[0].description == "up to\u2026 \u20ac"


KINDS = list(dcm._KINDS)
BLOCK = "FESTWERT b\n  WERT 1\nEND\n"


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
        *((f"KONSERVIERUNG_FORMAT 2.0\n{kind} a\n{BLOCK}", 2) for kind in (*KINDS, "FUNKTIONEN")),
        *((f"KONSERVIERUNG_FORMAT 2.0\nFESTWERT a\n{kind} {BLOCK}", 2) for kind in (*KINDS, "TEXTSTRING")),
    ],
)
def test_the_first_fault_is_named_with_its_line(text: str, line: int) -> None:
    refused = faults_of(dcm.read, text.encode(), "a.dcm")
    assert [problem.field for problem in refused] == [f"a.dcm, line {line}"]
    assert all(problem.remedy for problem in refused)


@given(st.binary(max_size=200).map(lambda tail: b"KONSERVIERUNG_FORMAT 2.0\n" + tail))
def test_any_bytes_are_read_or_refused(file: bytes) -> None:
    with contextlib.suppress(InvalidInputError):
        assert dcm.read(file, "a.dcm").characteristics is not None
