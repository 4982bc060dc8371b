import os
import tempfile
from pathlib import Path

import pytest
from tests.support.changes import replace_in

from drivecal.runtime import cache, compilation


def test_numba_gets_a_folder_if_the_sources_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writable: set[Path] = {Path(compilation.__file__).parent}
    for module in (compilation, cache):
        replace_in(monkeypatch, module, "os", access=lambda path, _: Path(path) in writable)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.setenv("HOME", str(tmp_path))
    compilation.prepare_cache()
    assert os.environ["NUMBA_CACHE_DIR"] == ""
    writable = {tmp_path / ".cache" / "numba"}
    compilation.prepare_cache()
    assert os.environ["NUMBA_CACHE_DIR"] == str(tmp_path / ".cache" / "numba"), "simulators have another home"
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    writable = set()
    compilation.prepare_cache()
    folder = Path(os.environ["NUMBA_CACHE_DIR"])
    assert folder.is_dir()
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    compilation.prepare_cache()
    assert Path(os.environ["NUMBA_CACHE_DIR"]) == folder


def test_a_kernels_folder_begins_with_those_of_the_image(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shipped, folder = tmp_path / "shipped", tmp_path / "mine" / "numba"
    (shipped / "planner").mkdir(parents=True)
    (shipped / "planner" / "kernel.nbi").write_text("compiled")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    monkeypatch.setenv(compilation.SHIPPED, str(tmp_path / "nowhere"))
    compilation.prepare_cache()
    assert not folder.exists()
    monkeypatch.setenv(compilation.SHIPPED, str(shipped))
    compilation.prepare_cache()
    (folder / "planner" / "kernel.nbi").write_text("recompiled")
    compilation.prepare_cache()
    assert (folder / "planner" / "kernel.nbi").read_text() == "recompiled"
    assert [path.name for path in folder.parent.iterdir()] == ["numba"]
