"""Limits of the files of a session: in folders, without a name, hidden, and in memory."""

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from tests.support.serve import until
from tests.support.simulators import as_another_user, lost, nest, scratch_of, served

from drivecal.adapters import children, files
from drivecal.adapters.files import remove
from drivecal.domain.evaluations import Breakdown

MEGABYTE = 1 << 20
ALWAYS = -(10**12)
"""Files are counted at each look: the room that others free meanwhile must not hide what a session takes."""


def limit(monkeypatch: pytest.MonkeyPatch, **limits: int) -> None:
    """Sets limits of the disk for new sessions, which look at it often."""
    monkeypatch.setattr(children, "LOOK_SECONDS", 0.1)
    for name, value in limits.items():
        monkeypatch.setattr(files, name, value)


@pytest.mark.parametrize("most", [{"MOST_DISK_MB": 100}, {"MOST_FILES": 50}])
def test_files_that_fill_the_disk_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most: dict[str, int]) -> None:
    limit(monkeypatch, **most, NOTICED_MB=ALWAYS)
    size = 2_000_000 if "MOST_DISK_MB" in most else 1
    fill = f"[open(os.path.join(os.environ['TMPDIR'], 'f%d' % n), 'wb').write(bytes({size})) for n in range(100)]"
    with served(tmp_path, f"if x == 1.0:\n    {fill}\n    time.sleep(600)") as session:
        assert "of disk" in lost(session, {"x": 1.0}, Breakdown.ERROR)
        assert sum(1 for _ in scratch_of(session).home.rglob("*")) == 0
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}


def test_files_are_counted_after_a_loss_of_room_for_bytes_or_for_files() -> None:
    before = files.Room(1000, 100_000)
    after = [files.Room(936, 100_000), files.Room(1000, 90_000), files.Room(937, 90_001), files.Room(2000, 200_000)]
    assert [room.lost(before) for room in after] == [True, True, False, False]


def test_a_session_that_holds_much_of_a_full_disk_is_ended_and_emptied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limit(monkeypatch, NOTICED_MB=5)
    fill = "open(os.path.join(os.environ['TMPDIR'], '..', 'f'), 'wb').write(bytes(20_000_000))"
    with served(tmp_path, f"if x == 1.0:\n    {fill}\n    time.sleep(600)") as session:
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}
        monkeypatch.setattr(files.Room, "of", lambda _: files.Room(10, 10**6, is_scarce=True))
        assert "10 MB left" in lost(session, {"x": 1.0}, Breakdown.ERROR)
        assert not (scratch_of(session).folder / "f").exists()
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}


NAMELESS = {
    "removed": "file = open('f', 'wb', 0); os.remove('f'); file.write(bytes(120 << 20))",
    "never named": "file = os.open('.', os.O_TMPFILE | os.O_WRONLY); os.write(file, bytes(120 << 20))",
    "mapped": """
import mmap
file = open('f', 'w+b', 0); file.write(bytes(120 << 20))
kept = mmap.mmap(file.fileno(), 0); os.remove('f'); file.close()
os.closerange(3, 64)""",
    "of a thread": """
import ctypes, threading
def write():
    ctypes.CDLL(None).unshare(0x400)  # CLONE_FILES: from here on it has descriptors of its own
    file = open('f', 'wb', 0); os.remove('f'); file.write(bytes(120 << 20)); time.sleep(600)
threading.Thread(target=write).start()""",
    "of a thread that outlives the first": """
import ctypes, threading
def write():
    file = open('f', 'wb', 0); os.remove('f'); file.write(bytes(120 << 20)); time.sleep(600)
threading.Thread(target=write).start()
ctypes.CDLL(None).pthread_exit(None)""",
}


@pytest.mark.parametrize("body", NAMELESS.values(), ids=NAMELESS)
def test_files_without_a_name_fill_no_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str) -> None:
    limit(monkeypatch, MOST_DISK_MB=100, NOTICED_MB=ALWAYS)
    body = body.strip().replace("\n", "\n    ")
    with served(tmp_path, f"if x == 1.0:\n    {body}\n    time.sleep(600)") as session:
        assert "of disk" in lost(session, {"x": 1.0}, Breakdown.ERROR)
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}


def test_a_session_with_hidden_files_is_ended_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Other users than root see no files of a process that may not be debugged."""
    limit(monkeypatch, NOTICED_MB=5)
    shown = files.find_nameless
    with served(tmp_path, "if x == 1.0: time.sleep(600)") as session:
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}
        room = session._children._disk._opened.megabytes
        monkeypatch.setattr(files, "find_nameless", lambda *arguments, **options: replaced(shown(*arguments, **options)))
        monkeypatch.setattr(files.Room, "of", lambda _: files.Room(room, 10**9, is_scarce=True))
        session._children.look()  # as full as before
        monkeypatch.setattr(files.Room, "of", lambda _: files.Room(room - 10, 10**9, is_scarce=True))
        assert "hides its open files" in lost(session, {"x": 1.0}, Breakdown.ERROR)


def replaced(nameless: files.Nameless) -> files.Nameless:
    """Makes the scan incomplete, as for users other than root."""
    nameless.is_complete = False
    return nameless


def test_a_process_that_hides_its_files_is_told_from_one_that_has_ended() -> None:
    """As another user than root, who sees everything. This process may not be debugged since it changed its user, nor may its copy."""

    def looks(folder: Path) -> None:
        ended = subprocess.Popen(["true"], cwd=folder)  # not waited for
        until(lambda: b") Z " in Path(f"/proc/{ended.pid}/stat").read_bytes())
        hiding = os.fork()
        if hiding == 0:
            signal.pause()
        assert files.find_nameless([ended.pid], str(folder)).is_complete
        assert not files.find_nameless([hiding], str(folder)).is_complete
        os.kill(hiding, signal.SIGKILL)

    as_another_user(looks)


@pytest.mark.parametrize("mode", [0o333, 0o444, 0o000])
def test_a_folder_without_rights_cannot_hide_files(mode: int) -> None:
    """From another user than root, who reads everything."""

    def counts(folder: Path) -> None:
        (folder / "hidden").mkdir()
        (folder / "hidden" / "file").write_text("1")
        (folder / "hidden").chmod(mode)
        with pytest.raises(files.UncountableError, match="Permission denied"):
            files.count_written(str(folder), 100)

    as_another_user(counts)


def test_a_tree_beyond_the_longest_path_cannot_hide_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limit(monkeypatch, NOTICED_MB=ALWAYS)
    deep = "[(os.mkdir('deep'), os.chdir('deep')) for _ in range(1500)]"
    with served(tmp_path, f"if x == 1.0:\n    {deep}\n    time.sleep(600)") as session:
        assert "cannot be counted: File name too long" in lost(session, {"x": 1.0}, Breakdown.ERROR)
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}


def test_a_deep_tree_that_a_path_can_name_is_counted(tmp_path: Path) -> None:
    (tmp_path / "scratch").mkdir()
    nest(tmp_path / "scratch", "d", 1500)
    assert files.count_written(str(tmp_path / "scratch"), 10_000)[1] == 1500
    remove(tmp_path / "scratch")  # pytest recurses


CHURN = "import os\nwhile True:\n for n in range(100): open(f'f{n}', 'w').close()\n for n in range(100): os.remove(f'f{n}')"


def test_files_that_go_while_they_are_counted_do_not_hide_others(tmp_path: Path) -> None:
    (tmp_path / "large").write_bytes(bytes(MEGABYTE))
    with subprocess.Popen([sys.executable, "-S", "-c", CHURN], cwd=tmp_path) as writer:
        until(lambda: len(list(tmp_path.iterdir())) > 1)
        counts = [files.count_written(str(tmp_path), 10_000)[0] for _ in range(1000)]
        writer.kill()
    assert min(counts) >= MEGABYTE


def test_a_count_ends_at_its_limit(tmp_path: Path) -> None:
    for number in range(20):
        (tmp_path / str(number)).touch()
    assert files.count_written(str(tmp_path), 5)[1] == 6


@pytest.mark.skipif(not files.is_in_memory("/dev/shm"), reason="this machine has no file system in memory")
def test_files_in_memory_take_no_more_than_the_memory_of_the_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limit(monkeypatch, NOTICED_MB=ALWAYS)
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        monkeypatch.setattr(tempfile, "tempdir", folder)
        fill = "[open('f%d' % n, 'wb').write(bytes(10 << 20)) for n in range(12)]"
        with served(tmp_path, f"if x == 1.0:\n    {fill}\n    time.sleep(600)", memory_mb=100) as session:
            assert "more than 100 MB" in lost(session, {"x": 1.0}, Breakdown.ERROR)
            assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}


def test_disks_are_told_from_memory() -> None:
    """A later mount on a folder hides the earlier mount."""
    mounts = [line.split(" - ") for line in Path("/proc/self/mountinfo").read_text().splitlines()]
    systems = {mount.split()[4]: system.split()[0] for mount, system in mounts}
    shown = {place: system for place, system in systems.items() if system in {"tmpfs", "proc", "ext4", "sysfs", "overlay"}}
    assert {at: files.is_in_memory(at) for at in shown} == {at: system == "tmpfs" for at, system in shown.items()}


@pytest.mark.slow
def test_files_of_memory_count_once_and_not_only_while_they_are_mapped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(children, "LOOK_SECONDS", 0.1)
    write = "import mmap; file = os.memfd_create('m'); [os.write(file, bytes(10 << 20)) for _ in range({tens})]"
    mapped = f"{write.format(tens=12)}; kept = mmap.mmap(file, 0); assert sum(kept[::4096]) == 0; time.sleep(1)"
    body = f"if x == 1.0:\n    {write.format(tens=30)}\n    time.sleep(600)\nelse:\n    {mapped}"
    with served(tmp_path, body, memory_mb=200) as session:
        assert "MB of memory" in lost(session, {"x": 1.0}, Breakdown.MEMORY)
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}


@pytest.mark.slow
def test_more_open_files_than_can_be_looked_at_cost_their_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limit(monkeypatch)
    monkeypatch.setattr(files, "MOST_LOOKS", 200)
    many = "import os\nif x == 1.0:\n    kept = [os.dup(1) for _ in range(300)]\n    time.sleep(600)"
    with served(tmp_path, many) as session:
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}
        assert "more than 200 files open" in lost(session, {"x": 1.0}, Breakdown.ERROR)
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}


def test_more_mappings_than_can_be_counted_are_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(files, "MOST_MAPPINGS", 5)
    with pytest.raises(files.UncountableError):
        files.find_mapped([os.getpid()], str(tmp_path))
