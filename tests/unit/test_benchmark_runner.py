"""The program behind `make bench`."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

RUNNER = Path(__file__).parents[1] / "benchmarks" / "run.py"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the runner and three benchmarks: a good one, a poor one and a crashing one."""
    shutil.copy(RUNNER, tmp_path)
    (tmp_path / "a_breaks.py").write_text("raise RuntimeError('broken')\n")
    (tmp_path / "b_bad.py").write_text("import sys; print('table of b'); sys.exit(3)\n")
    (tmp_path / "c_good.py").write_text("import sys; print('table of c', sys.argv[1:])\n")
    return tmp_path


def run(folder: Path, *names: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, str(folder / "run.py"), *names], capture_output=True, text=True, check=False)


def test_one_that_fails_does_not_stop_the_others_but_shows_at_the_end(folder: Path) -> None:
    done = run(folder)
    assert done.returncode == 1
    assert "table of b" in done.stdout
    assert "table of c" in done.stdout
    summary = [(line.split()[0], line.split("  ")[-1]) for line in done.stdout.splitlines()[-3:]]
    assert summary == [("a_breaks", "not good enough (exit 1)"), ("b_bad", "not good enough (exit 3)"), ("c_good", "good")]


def test_benchmarks_can_be_chosen_by_name(folder: Path) -> None:
    done = run(folder, "c_good")
    assert done.returncode == 0
    assert "table of b" not in done.stdout


def test_an_unknown_benchmark_is_refused_with_those_there_are(folder: Path) -> None:
    done = run(folder, "c_good", "nonsense")
    assert done.returncode == 2
    assert all(name in done.stderr for name in ("nonsense", "a_breaks", "b_bad", "c_good"))
    assert not done.stdout


def test_options_go_to_the_one_benchmark_that_is_named(folder: Path) -> None:
    done = run(folder, "c_good", "--size", "7")
    assert (done.returncode, "table of c ['--size', '7']" in done.stdout) == (0, True)
    for arguments in (["--size", "7"], ["b_bad", "c_good", "--size", "7"]):
        done = run(folder, *arguments)
        assert (done.returncode, done.stderr) == (2, "options are those of one benchmark: run.py NAME OPTION ...\n")
