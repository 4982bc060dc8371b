"""Calibration files of public projects, read by drivecal and by a second reader. `make test-packages`.

The files come in packages of PyPI under the GPL, so they are fetched and not stored here: `ASAP2_Demo_V161.a2l` of pya2ldb, which reads A2L
by a parser in C++, and ASAM's and ETAS's demonstrations of CDF 2.0 in the source archive of asamint. No package holds a DCM: that of
a public project under the MIT licence is next to `tests/unit/calibration_data/test_dcm.py`.
"""

import hashlib
import json
import subprocess
import sys
import tarfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from drivecal.calibration_data import files
from drivecal.calibration_data.sections import chosen_by, joined, sections_of
from drivecal.domain.errors import InvalidInputError

pytestmark = [pytest.mark.packages, pytest.mark.timeout(900)]

A2L, CDF = "pya2ldb==1.0.355", "asamint==0.2.2"
ASAP2_DEMO, CDF20_DEMO = "pya2l/examples/ASAP2_Demo_V161.a2l", "asamint-0.2.2/asamint/examples/cdf/CDF20demo"
FILES = {
    ASAP2_DEMO: "c2d9d3a0f379c56e5068ac1a59aa924800ba8ceb0f395c03e6b497d51443bbe9",
    "asamint-0.2.2/asamint/examples/ASAP2_Demo_V161.a2l": "0dba64305b0a371412fed9a7bb56a887c2abf7b3ba22f1844e93c535e09e7a0b",
    "asamint-0.2.2/asamint/examples/msrsw_a2l_example.a2l": "e89396e5c5b122948d17466be1814e8dbb90713a5c7a3c7f36fd75040571c26c",
    f"{CDF20_DEMO}.a2l": "1d7ad0ae1cdd6d063ce7b0739f8aed70b53f86625bd87e81b285ab446f2e0ac3",
    f"{CDF20_DEMO}.cdfx": "dd024a95659c9a4693127ae43cee6efd7bce04dac74c82cc9f797237c8d7099a",
}
"""SHA-256 of the files that the numbers below are about."""
RASTER = 1e-4
"""Largest distance of drivecal's limits from the file's, as a share: drivecal rounds inwards to values of the control unit."""
BY_ANOTHER = """
import json
import pya2l
from pya2l import model

session = pya2l.import_a2l(sys.argv[1], in_memory=True, loglevel="ERROR", progress_bar=False)
units = {row.name: row.unit for row in session.query(model.CompuMethod)}
rows = [
    (
        row.name, row.longIdentifier, row.type, row.lowerLimit, row.upperLimit,
        row.phys_unit.unit if row.phys_unit else units.get(row.conversion, ""),
        row.conversion in units or row.conversion == "NO_COMPU_METHOD",
        any((row.dependent_characteristic, row.virtual_characteristic, row.read_only)),
    )
    for row in session.query(model.Characteristic)
]
json.dump(rows, open(sys.argv[2], "w"))
"""


def pip(*words: str) -> None:
    """Runs pip."""
    subprocess.run([sys.executable, "-m", "pip", *words, "--quiet", "--disable-pip-version-check", "--no-deps"], check=True)


@pytest.fixture(scope="module")
def fetched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with pya2ldb installed in it, and the source archive of asamint."""
    folder = tmp_path_factory.mktemp("public")
    pip("install", "--target", str(folder), A2L)
    pip("download", "--no-binary", "asamint", "--dest", str(folder), CDF)
    (archive,) = folder.glob("asamint-*.tar.gz")
    with tarfile.open(archive) as content:
        content.extractall(folder, filter="data")
    return folder


def public(fetched: Path, name: str) -> bytes:
    """Content of one of `FILES`."""
    content = (fetched / name).read_bytes()
    assert hashlib.sha256(content).hexdigest() == FILES[name]
    return content


def by_another(fetched: Path, folder: Path, content: bytes) -> list[list[Any]]:
    """The characteristics of an A2L, read by pya2ldb in a process of its own."""
    file, answer = folder / "public.a2l", folder / "rows.json"
    file.write_bytes(content)
    code = f"import sys; sys.path.append({str(fetched)!r})\n{BY_ANOTHER}"
    subprocess.run([sys.executable, "-c", code, file.name, str(answer)], check=True, capture_output=True, cwd=folder)
    rows: list[list[Any]] = json.loads(answer.read_text())
    return rows


@pytest.mark.parametrize(
    ("name", "scalars", "faults"),
    list(zip([name for name in FILES if name.endswith(".a2l")], (35, 23, 1, 28), (7, 2, 0, 0), strict=True)),
)
def test_another_reader_has_the_same_characteristics_of_an_a2l(
    fetched: Path, tmp_path: Path, name: str, scalars: int, faults: int
) -> None:
    content = files.read(public(fetched, name), name)
    rows = by_another(fetched, tmp_path, public(fetched, name))
    theirs = {
        label: (
            " ".join(description.split()),
            *(pytest.approx(limit, rel=RASTER) for limit in (lower, upper)),
            unit.strip().strip("-"),
            is_described,
        )
        for label, description, kind, lower, upper, unit, is_described, follows in rows
        if kind == "VALUE" and not follows
    }
    ranges = (
        ("VTAB_RANGE", "TAB_VERB") if name.startswith("pya2l") else ("VTAB_RANGE",)
    )  # a text of theirs stands for many values
    for label in theirs:
        if any(part in label for part in ranges):
            theirs[label] = (*theirs[label][:-1], False)
    ours = {
        row.name: (row.description, row.lower, row.upper, "" if row.unit == "1" else row.unit, row.fault is None)
        for row in content.characteristics
    }
    assert ours == theirs
    assert sorted(content.skipped) == sorted(row[0] for row in rows if row[0] not in theirs)
    assert len(ours) == scalars
    assert sum(row.fault is not None for row in content.characteristics) == faults


def test_what_has_a_fault_in_a_public_a2l_is_refused_with_line_and_remedy_and_the_rest_is_usable(fetched: Path) -> None:
    content = files.read(public(fetched, ASAP2_DEMO), "demo.a2l")
    faulty = [row for row in content.characteristics if row.fault is not None]
    with pytest.raises(InvalidInputError) as refused:
        sections_of(faulty[:1], {}, 0.5)
    assert [problem.field for problem in refused.value.problems] == ["demo.a2l, line 4361"]
    assert "--match" in refused.value.problems[0].remedy
    chosen = chosen_by(content.characteristics, ["ASAM.C.SCALAR.?BYTE.*"])
    assert set(sections_of(chosen, {}, 0.5).parameters) == {row.name for row in chosen}
    assert not set(faulty) & set(chosen)


def test_an_xml_library_has_the_same_scalars_of_a_cdfx(fetched: Path) -> None:
    content = files.read(public(fetched, f"{CDF20_DEMO}.cdfx"), "demo.cdfx")
    root = ET.fromstring(public(fetched, f"{CDF20_DEMO}.cdfx"))
    leaves = [node for node in root.iter("SW-INSTANCE") if node.find("SW-INSTANCE") is None]
    scalars = [node for node in leaves if node.findtext("CATEGORY") in {"VALUE", "BOOLEAN", "ASCII"}]
    theirs = []
    for node in scalars:
        (value,) = node.iterfind(".//SW-VALUES-PHYS/*")
        text = (value.text or "").strip()
        theirs.append(
            (node.findtext("SHORT-NAME"), text if value.tag == "VT" else float(text), node.findtext("LONG-NAME") or "")
        )
    assert [(row.name, row.value, row.description) for row in content.characteristics] == theirs
    assert (len(theirs), len(content.skipped)) == (4, len(leaves) - 4)


def test_an_a2l_and_the_cdfx_that_belongs_to_it_become_a_parameter(fetched: Path) -> None:
    given = [files.read(public(fetched, CDF20_DEMO + end), f"demo{end}") for end in (".a2l", ".cdfx")]
    chosen = chosen_by(joined(content.characteristics for content in given), ["CDF20.Dependent.Base*"])
    sections = sections_of(chosen, {"CDF20.Dependent.Base.FW_wU16": "base"}, 0.5)
    assert sections.parameters == {"base": {"lower": 0, "upper": 35565, "integer": True, "description": "Dependent Base"}}
    assert sections.baseline == {"base": 17}


@pytest.mark.parametrize("name", FILES)
def test_a_part_of_a_public_file_is_refused_with_its_line(fetched: Path, name: str) -> None:
    whole = public(fetched, name).rstrip()
    for share in range(1, 20):
        with pytest.raises(InvalidInputError) as refused:
            files.read(whole[: len(whole) * share // 20], f"part{Path(name).suffix}")
        (problem,) = refused.value.problems
        assert problem.field.startswith(f"part{Path(name).suffix}, line ")
        assert problem.remedy
