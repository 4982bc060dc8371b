"""The release that nodes compare."""

import os
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

from drivecal.cluster.settings import release, sources_digest


def written(root: Path, **modules: str) -> Path:
    for name, content in modules.items():
        file = root / name / "module.py"
        file.parent.mkdir(parents=True)
        file.write_text(content)
    return root


def test_equal_sources_are_equal_releases_wherever_they_lie(tmp_path: Path) -> None:
    whole = written(tmp_path / "wheel", a="1\n", b="2\n")
    parts = [written(tmp_path / "services", b="2\n"), written(tmp_path / "shared", a="1\n")]
    assert sources_digest([whole]) == sources_digest(parts)
    (whole / "a" / "data.json").write_text("{}")
    assert sources_digest([whole]) == sources_digest(parts)


def test_any_other_source_is_another_release(tmp_path: Path) -> None:
    digests = {
        sources_digest([written(tmp_path / str(number), **modules)])
        for number, modules in enumerate(({"a": "1\n"}, {"a": "2\n"}, {"b": "1\n"}, {"a": "1\n", "b": ""}))
    }
    assert len(digests) == 4


def test_a_release_is_a_label_that_ray_accepts() -> None:
    assert release().startswith(f"{version('drivecal')}-")
    assert re.fullmatch(r"[a-zA-Z0-9][a-zA-Z0-9_.-]{0,61}[a-zA-Z0-9]", release())


def test_folders_beside_the_installation_change_no_release(tmp_path: Path) -> None:
    written(tmp_path / "drivecal", stray="1\n")
    (tmp_path / "drivecal" / "stray" / ".#lock.py").symlink_to("nobody@nowhere")
    there = subprocess.run(
        [sys.executable, "-c", "from drivecal.cluster.settings import release; print(release())"],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(tmp_path)}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert there.stdout.strip() == release()
