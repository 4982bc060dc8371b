"""Each role by itself, as it runs in a container: what it says where something is missing."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


def run(folder: Path, *words: str, **settings: str) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("DRIVECAL_", "RAY_"))}
    environment = kept | {"HOME": str(folder), "DRIVECAL_HOME": str(folder), **settings}
    command = [sys.executable, "-m", *words]
    return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, timeout=1800, check=False)


@pytest.mark.slow
def test_a_missing_password_ends_a_role_with_one_line_that_names_the_file(tmp_path: Path) -> None:
    url = "postgresql://drivecal@127.0.0.1:9/drivecal"
    done = run(
        tmp_path, "drivecal.dispatch", DRIVECAL_DATABASE_URL=url, DRIVECAL_DATABASE_PASSWORD_FILE=str(tmp_path / "password")
    )
    assert done.returncode == 1
    assert f"database_password_file: {tmp_path / 'password'}" in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("words", [("head",), ("worker", "127.0.0.1:9")], ids=lambda words: words[0])
def test_a_node_without_the_clusters_token_ends_with_one_line_that_says_so(tmp_path: Path, words: tuple[str, ...]) -> None:
    done = run(tmp_path, "drivecal.cluster", *words, RAY_AUTH_TOKEN_PATH=str(tmp_path / "ray_token"))
    assert done.returncode == 1
    assert str(tmp_path / "ray_token") in done.stderr
    assert len(done.stderr.splitlines()) == 1
