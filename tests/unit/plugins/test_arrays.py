"""Files of arrays: what was written comes back, and whatever else there may be in a file is refused."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.support.effort import examples

from drivecal.plugins.arrays import Array, DamagedArraysError, Expected, read_arrays, write_arrays

KIND = "test arrays 1"
EXPECTED = {"weights": Expected("float64", (None, 2)), "places": Expected("int32", (3,))}


def arrays() -> dict[str, Array]:
    return {"weights": np.arange(6.0).reshape(3, 2), "places": np.array([4, 5, 6], dtype=np.int32)}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "model.npz"
    write_arrays(path, KIND, arrays())
    return path


def refused(path: Path) -> str:
    with pytest.raises(DamagedArraysError) as caught:
        read_arrays(path, KIND, EXPECTED)
    assert str(path.name) in str(caught.value)
    return caught.value.reason


def test_what_was_written_comes_back(file: Path) -> None:
    stored = read_arrays(file, KIND, EXPECTED)
    assert stored.keys() == EXPECTED.keys()
    for name, array in arrays().items():
        np.testing.assert_array_equal(stored[name], array, strict=True)


def test_the_same_arrays_give_the_same_bytes(file: Path, tmp_path: Path) -> None:
    write_arrays(tmp_path / "third.npz", KIND, arrays())
    assert (tmp_path / "third.npz").read_bytes() == file.read_bytes()


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    assert "cannot be read" in refused(tmp_path / "nothing.npz")


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04", b"\x93NUMPY\x01\x00"])
def test_what_is_no_archive_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "model.npz"
    path.write_bytes(content)
    assert "cannot be read" in refused(path) or "is no" in refused(path)


def test_a_file_of_another_kind_is_refused_by_its_name(file: Path) -> None:
    write_arrays(file, "other arrays 7", arrays())
    assert "other arrays 7" in refused(file)


def test_a_file_without_a_label_is_refused(file: Path) -> None:
    np.savez(file, allow_pickle=False, **arrays())
    assert KIND in refused(file)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"weights": np.zeros((3, 3))}, "shape"),
        ({"weights": np.zeros(6)}, "shape"),
        ({"weights": np.zeros((3, 2), dtype=np.float32)}, "float32"),
        ({"weights": np.full((3, 2), np.nan)}, "not finite"),
        ({"places": np.zeros(4, dtype=np.int32)}, "shape"),
        ({"more": np.zeros(1)}, "more"),
    ],
)
def test_arrays_that_do_not_fit_are_refused_by_name(file: Path, change: dict[str, Array], reason: str) -> None:
    write_arrays(file, KIND, arrays() | change)
    assert reason in refused(file)


def test_a_missing_array_is_refused(file: Path) -> None:
    write_arrays(file, KIND, {"weights": arrays()["weights"]})
    assert "places, weights" in refused(file)


def test_a_value_that_was_changed_is_refused_by_the_digest(file: Path) -> None:
    with np.load(file, allow_pickle=False) as content:
        changed = dict(content)
    changed["weights"] = changed["weights"] + 1e-12
    np.savez(file, allow_pickle=False, **changed)
    assert "digest" in refused(file)


def test_pickled_objects_are_refused_without_being_loaded(file: Path, tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[object, tuple[str, ...]]:
            return os.mkdir, (str(tmp_path / "sprung"),)

    np.savez(file, weights=np.array([Trap()], dtype=object))
    assert "cannot be read" in refused(file)
    assert not (tmp_path / "sprung").exists()


def test_a_file_that_says_it_is_encrypted_is_refused(file: Path) -> None:
    content = bytearray(file.read_bytes())
    entry = content.index(b"PK\x01\x02")  # of the central directory
    content[entry + 8] |= 1
    file.write_bytes(content)
    assert "encrypted" in refused(file)


def test_a_huge_file_is_refused_without_being_read(file: Path) -> None:
    with file.open("ab") as end:
        end.truncate(10_000_000)
    assert "bytes" in refused(file)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=examples(200), deadline=None)
@given(place=st.floats(0.0, 1.0, exclude_max=True), mask=st.integers(1, 255), cut=st.booleans())
def test_damage_is_refused_or_did_not_touch_the_arrays(file: Path, place: float, mask: int, cut: bool) -> None:
    content = file.read_bytes()
    at = int(place * len(content))
    damaged = file.with_name("damaged.npz")
    damaged.write_bytes(content[:at] if cut else content[:at] + bytes([content[at] ^ mask]) + content[at + 1 :])
    try:
        stored = read_arrays(damaged, KIND, EXPECTED)
    except DamagedArraysError:
        return
    for name, array in arrays().items():
        np.testing.assert_array_equal(stored[name], array, strict=True)
