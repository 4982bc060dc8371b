"""Calibration files of public projects, read by drivecal and by a second reader. `make test-packages`.

The files come in packages of PyPI under the GPL, so they are fetched and not stored here: `ASAP2_Demo_V161.a2l` of pya2ldb, which reads A2L
by a parser in C++, and ASAM's and ETAS's demonstrations of CDF 2.0 in the source archive of asamint. No package holds a DCM: that of
a public project under the MIT licence is next to `tests/unit/calibration_data/test_curves.py`.
"""

import hashlib
import json
import math
import subprocess
import sys
import tarfile
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from tests.unit.calibration_data.test_curves import expected, in_another_reader

from drivecal.calibration_data import files
from drivecal.calibration_data.carried import carried
from drivecal.calibration_data.characteristics import Characteristic
from drivecal.calibration_data.sections import joined, sections_of

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
KINDS = {"VALUE", "CURVE", "MAP", "VAL_BLK"}
RASTER = 2e-3
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
        [
            (
                axis.attribute,
                axis.axis_pts_ref.axisPoints if axis.axis_pts_ref else "",
                axis.fix_axis_par_dist.numberapo if axis.fix_axis_par_dist else
                len(axis.fix_axis_par_list.axisPts_Value) if axis.fix_axis_par_list else 0,
            )
            for axis in row.axis_descr
        ],
        list(row.matrix_dim.numbers) if row.matrix_dim else [],
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
    pip("install", "--target", str(folder), A2L, "chardet==7.0.0")
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
    list(zip([name for name in FILES if name.endswith(".a2l")], (49, 37, 3, 43), (7, 2, 0, 0), strict=True)),
)
def test_another_reader_reads_the_same_a2l(fetched: Path, tmp_path: Path, name: str, scalars: int, faults: int) -> None:
    content = files.read(public(fetched, name), name)
    rows = by_another(fetched, tmp_path, public(fetched, name))
    theirs = {
        label: (
            " ".join(description.split()),
            *(pytest.approx(limit, rel=RASTER) for limit in (lower, upper)),
            unit.strip().strip("-"),
            is_described,
        )
        for label, description, kind, lower, upper, unit, is_described, follows, axes, sizes in rows
        if kind in KINDS and not follows and "CURVE_AXIS" not in [axis[0] for axis in axes] and (kind != "VAL_BLK" or sizes)
    }
    # a text of theirs stands for many values
    ranges = ("VTAB_RANGE", "TAB_VERB") if name.startswith("pya2l") else ("VTAB_RANGE",)
    for label in theirs:
        if any(part in label for part in ranges):
            theirs[label] = (*theirs[label][:-1], False)
    ours = {
        row.name: (row.description, row.lower, row.upper, "" if row.unit == "1" else row.unit, row.fault is None)
        for row in content.characteristics
        if row.kind != "COM_AXIS"
    }
    assert ours == theirs
    axes = {row[0]: row[8:] for row in rows}
    for row in content.characteristics:
        if row.kind in {"CURVE", "MAP"}:
            assert [[axis.kind, axis.shared, len(axis.points)] for axis in row.axes] == axes[row.name][0]
        elif row.kind == "VAL_BLK":
            assert [len(axis.points) for axis in row.axes] == [size for size in axes[row.name][1] if size > 1]
    assert sorted(content.skipped) == sorted(row[0] for row in rows if row[0] not in theirs)
    assert len(ours) == scalars
    assert sum(row.fault is not None for row in content.characteristics) == faults


def of_xml(content: bytes) -> dict[str, list[Any]]:
    """Values and points of axes in a CDFX by name, as an XML library has them."""
    return {
        node.findtext("SHORT-NAME") or "": [
            [each.text if each.tag == "VT" else float(each.text or "") for each in part.iter() if each.tag in {"V", "VT"}]
            for part in node.iterfind(".//SW-VALUES-PHYS")
        ]
        for node in ET.fromstring(content).iter("SW-INSTANCE")
    }


def expected_in_xml(row: Characteristic, own: Collection[str]) -> list[Any]:
    """The same of a characteristic; `own`: kinds of axes whose points stand with its values."""
    return [list(row.values) or [row.value], *(list(axis.points) for axis in row.axes if axis.kind in own)]


@pytest.mark.parametrize("name", [name for name in FILES if name.startswith("asamint") and name.endswith(".a2l")])
def test_curves_and_maps_of_a_public_a2l_suit_other_readers(fetched: Path, tmp_path: Path, name: str) -> None:
    described = files.read(public(fetched, name), name).characteristics
    if name.startswith(CDF20_DEMO):
        held = files.read(public(fetched, f"{CDF20_DEMO}.cdfx"), "demo.cdfx").characteristics
        fixed = [row.axes[0].points for row in [*described, *held] if row.name == "CDF20.curve.FKL_xFIX_wU8"]
        assert fixed[0] == fixed[1]
        theirs = of_xml(public(fetched, f"{CDF20_DEMO}.cdfx"))
        ours = {row.name: expected_in_xml(row, {"STD_AXIS", "FIX_AXIS"}) for row in held if "ASCII" not in row.name}
        assert (len(ours), ours) == (9, {name: theirs[name] for name in ours})
    else:  # no file has their values
        held = []
        for row in (row for row in described if row.axes):
            axes = tuple(replace(axis, points=axis.points or (1.5, 2.5, 4.0)) for axis in row.axes)
            values = range(math.prod(len(axis.points) for axis in axes))
            held.append(replace(row, axes=axes, values=tuple(value / 16 for value in values)))
    curves = [row for row in joined([described, held]) if row.values]
    assert {row.kind for row in curves} > {"CURVE", "COM_AXIS"}
    assert sections_of(curves, {}, 0.5).baseline.keys() == {row.name for row in curves}
    changed = replace(curves[0], values=(0.125, *curves[0].values[1:]))
    for rows, chosen in ((curves, []), ([changed, *curves[1:]], [changed])):
        for form in ("dcm", "cdfx"):
            (tmp_path / f"base.{form}").write_bytes(files.write(form, curves, None))
            (tmp_path / f"set.{form}").write_bytes(carried(tmp_path / f"base.{form}", form, chosen))
        assert in_another_reader(tmp_path / "set.dcm") == {row.name: expected(row) for row in rows}
        ours = {row.name: expected_in_xml(row, {"STD_AXIS", "FIX_AXIS", "COM_AXIS", "RES_AXIS"}) for row in rows}
        assert of_xml((tmp_path / "set.cdfx").read_bytes()) == ours
