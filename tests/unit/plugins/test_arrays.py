"""Files of arrays: what was written comes back, and a damaged file is refused."""

from pathlib import Path

import numpy as np
import pytest

from drivecal.plugins.arrays import DamagedArraysError, content_digest, read_arrays

ARRAYS = {"weights": np.arange(6.0).reshape(3, 2), "places": np.array([4, 5, 6], dtype=np.int32)}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "model.npz"
    np.savez_compressed(path, allow_pickle=False, **ARRAYS)
    return path


def test_what_was_written_comes_back(file: Path) -> None:
    stored = read_arrays(file, ARRAYS)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(stored[name], array, strict=True)


def test_damage_a_missing_array_and_executable_content_are_refused(file: Path) -> None:
    content = file.read_bytes()
    with pytest.raises(DamagedArraysError):
        read_arrays(file, [*ARRAYS, "biases"])
    np.savez(file, weights=np.array([object()], dtype=object), allow_pickle=True)
    for damaged in (file.read_bytes(), content[:-20], b"", content.replace(content[60:64], b"abcd")):
        file.write_bytes(damaged)
        with pytest.raises(DamagedArraysError, match=r"model\.npz"):
            read_arrays(file, ARRAYS)


def test_a_digest_changes_with_every_value_name_and_shape() -> None:
    others = [{"weights": ARRAYS["weights"]}, ARRAYS | {"weights": ARRAYS["weights"].reshape(2, 3)}]
    others.append(ARRAYS | {"places": ARRAYS["places"] + 1})
    assert len({content_digest(arrays) for arrays in [ARRAYS, *others]}) == 4
