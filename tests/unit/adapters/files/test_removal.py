"""Folders are removed as hostile simulators leave them, and nothing besides."""

import subprocess
import sys
from pathlib import Path

import pytest
from tests.support.simulators import as_another_user, nest

from drivecal.adapters.files import remove

DEEPER_THAN_RECURSION = 1_500
"""Also longer than a path may be, with names of four letters."""


@pytest.mark.parametrize("name", ["d", "deep"])
def test_a_tree_that_is_deeper_than_a_recursion_or_a_path_is_removed(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "scratch"
    folder.mkdir()
    nest(folder, name, DEEPER_THAN_RECURSION)
    (folder / "beside").mkdir()
    (folder / "beside" / "file").write_text("1")
    remove(folder)
    assert list(tmp_path.iterdir()) == []


def test_links_are_removed_and_what_they_lead_to_stays(tmp_path: Path) -> None:
    outside, folder = tmp_path / "outside", tmp_path / "scratch"
    (outside / "deep").mkdir(parents=True)
    (outside / "deep" / "file").write_text("content")
    outside.chmod(0o555)
    (folder / "a" / "b").mkdir(parents=True)
    for number, target in enumerate((outside, outside / "deep" / "file", Path("/nowhere"), Path("..", "..", "..", "outside"))):
        (folder / "a" / "b" / f"link{number}").symlink_to(target)
    (folder / "a" / "hard").hardlink_to(outside / "deep" / "file")
    remove(folder)
    assert not folder.exists()
    assert (outside / "deep" / "file").read_text() == "content"
    assert outside.stat().st_mode & 0o777 == 0o555


def test_a_link_in_the_place_of_the_folder_leads_nowhere(tmp_path: Path) -> None:
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "file").write_text("content")
    (tmp_path / "scratch").symlink_to(tmp_path / "outside")
    remove(tmp_path / "scratch")
    remove(tmp_path / "gone")
    assert (tmp_path / "outside" / "file").read_text() == "content"


@pytest.mark.parametrize("mode", [0o000, 0o333, 0o444, 0o555])
def test_folders_without_rights_are_removed(mode: int) -> None:
    """As another user than root, to whom rights mean nothing."""

    def removes(folder: Path) -> None:
        deepest = folder / "scratch" / "a" / "b" / "c"
        deepest.mkdir(parents=True)
        (deepest / "file").write_text("1")
        for path in (deepest, *list(deepest.parents)[:3]):
            path.chmod(mode)
        remove(folder / "scratch")
        assert list(folder.iterdir()) == []

    as_another_user(removes)


WRITER = "import os, sys\nos.chdir(sys.argv[1])\nfor n in range(10 ** 9): os.makedirs(f'a{n % 100}/{n}', exist_ok=True)"


def test_a_process_that_still_writes_holds_up_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "scratch"
    folder.mkdir()
    with subprocess.Popen([sys.executable, "-S", "-c", WRITER, str(folder)], stderr=subprocess.DEVNULL) as writer:
        remove(folder)
        writer.kill()
    remove(folder)
    assert list(tmp_path.iterdir()) == []
