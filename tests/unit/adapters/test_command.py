"""Simulators of kind `command`: files in, a file out, an exit code."""

import json
from pathlib import Path

import pytest
from tests.support.serve import until
from tests.support.simulators import hung, lost, opened, running, scratch_of, write_script

from drivecal.adapters.environment import GRANTED
from drivecal.adapters.kinds import simulator_of
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import VERSIONS, BusyError

COMMAND = ["./run.sh", "{parameters}", "{scenario}", "--out={results}"]
SCRIPT = """#!/bin/sh
results=${{3#--out=}}
x=$(sed 's/.*"x": \\([0-9]*\\).*/\\1/' "$1")
{body}
echo "{{\\"measures\\": {{\\"y\\": $((2 * x))}}}}" > "$results"
"""


def write(folder: Path, body: str = "") -> None:
    write_script(folder / "run.sh", SCRIPT.format(body=body))


def test_messages_show_paths_in_the_bundle_and_no_temporary_folders(tmp_path: Path) -> None:
    write(tmp_path, f'echo "$PWD: $PWD/mesh.dat $TMPDIR/part {tmp_path}/deep/mesh.dat" >&2; exit 1')
    with opened("command", tmp_path, command=COMMAND) as session:
        assert lost(session, {"x": 1}, Breakdown.CRASH).endswith("messages: .: mesh.dat part deep/mesh.dat")


def test_a_command_reads_files_and_writes_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "seen"
    monkeypatch.setenv(GRANTED, str(tmp_path))
    write(tmp_path, f'cat "$1" "$2" >> {out}')
    with opened("command", tmp_path, command=COMMAND) as session:
        assert session.evaluate({"x": 4}).measures == {"y": 8.0}
        assert session.evaluate({"x": 5, "mode": "eco"}).measures == {"y": 10.0}
    assert out.read_text() == '{"x": 4}{"k": 3}{"x": 5, "mode": "eco"}{"k": 3}'


def test_exit_code_75_means_busy_with_the_messages_as_its_reason(tmp_path: Path) -> None:
    write(tmp_path, 'if [ "$x" = 1 ]; then echo no licence >&2; exit 75; fi')
    with opened("command", tmp_path, command=COMMAND) as session:
        with pytest.raises(BusyError, match="no licence"):
            session.evaluate({"x": 1})
        assert session.evaluate({"x": 2}).measures == {"y": 4.0}


def test_a_command_gets_its_seed_as_a_word_and_as_a_variable(tmp_path: Path) -> None:
    write(tmp_path, "x=$((x + 100 * $4 + DRIVECAL_SEED))")
    with opened("command", tmp_path, command=[*COMMAND, "{seed}"]) as session:
        assert [session.evaluate({"x": 4}, seed=seed).measures["y"] for seed in (1, 3, 1)] == [210, 614, 210]


@pytest.mark.slow("exec sleep 600-hang-timeout")
@pytest.mark.parametrize(
    ("body", "breakdown", "detail"),
    [
        ("echo out; echo no licence >&2; exit 2", Breakdown.CRASH, "exit code 2; its last messages: out | no licence"),
        ("kill -SEGV $$", Breakdown.CRASH, "SIGSEGV"),
        ("echo done; exit 0", Breakdown.ERROR, "no results file: No such file or directory; its last messages: done"),
        ('echo nonsense > "$results"; exit 0', Breakdown.ERROR, "the results file is not JSON: nonsense"),
        ('echo \'{"error": "no mesh"}\' > "$results"; exit 0', Breakdown.ERROR, "no mesh"),
        ('ln -s /etc/hostname "$results"; exit 0', Breakdown.ERROR, "a link"),
        ('mkfifo "$results"; exit 0', Breakdown.ERROR, "not a regular file"),
        ('head -c 20000000 /dev/zero > "$results"; exit 0', Breakdown.ERROR, "16 MB"),
        ("exec sleep 600", Breakdown.HANG, "timeout"),
    ],
)
def test_a_fault_costs_its_run_only(tmp_path: Path, body: str, breakdown: Breakdown, detail: str) -> None:
    write(tmp_path, f'if [ "$x" = 1 ]; then\n{body}\nfi')
    with opened("command", tmp_path, command=COMMAND) as session:
        assert detail in (hung(session, {"x": 1}, 3.0) if breakdown is Breakdown.HANG else lost(session, {"x": 1}, breakdown))
        assert session.evaluate({"x": 2}).measures == {"y": 4.0}


def test_the_exit_code_of_a_shell_names_the_signal_that_ended_its_program(tmp_path: Path) -> None:
    write(tmp_path, 'if [ "$x" = 1 ]; then sh -c "kill -9 \\$\\$"; exit $?; fi; exit 200')
    with opened("command", tmp_path, command=COMMAND) as session:
        shown = lost(session, {"x": 1}, Breakdown.CRASH)
        assert all(part in shown for part in ("exit code 137", "SIGKILL", "memory"))
        assert "SIG" not in lost(session, {"x": 2}, Breakdown.CRASH)


def test_a_fault_leaves_no_temporary_files_to_the_next_run(tmp_path: Path) -> None:
    write(tmp_path, '[ -e "$TMPDIR/lock" ] && exit 3; touch "$TMPDIR/lock"; exit 4')
    with opened("command", tmp_path, command=COMMAND) as session:
        for _ in range(2):
            assert "exit code 4" in lost(session, {"x": 1}, Breakdown.CRASH)


def test_each_run_starts_in_empty_folders_with_links_to_the_bundle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(GRANTED, str(tmp_path))
    bundle = tmp_path / "bundle"
    bundle.mkdir()
    (bundle / "mesh").write_text("")
    left = 'left "$TMPDIR/left" "$(dirname "$1")/left"'
    body = f"[ -e mesh ] || exit 1\nfor each in {left}; do [ ! -e $each ] || exit 2; mkdir $each; done\nrm mesh\n"
    write(bundle, f"{body}echo . >> {tmp_path / 'count'}")
    with opened("command", bundle, command=COMMAND) as session:
        for _ in range(3):
            session.evaluate({"x": 2})
    assert (tmp_path / "count").read_text() == ".\n" * 3
    assert sorted(path.name for path in bundle.iterdir()) == ["mesh", "run.sh"]


def test_nothing_runs_after_a_run(tmp_path: Path) -> None:
    mark = f"6{abs(hash(tmp_path)) % 10**8}"
    write(tmp_path, f"sleep {mark} &\nsetsid sleep {mark} &")
    with opened("command", tmp_path, command=COMMAND) as session:
        assert session.evaluate({"x": 2}).measures == {"y": 4.0}
        assert running(mark) == []


def test_cpu_time_is_that_of_the_command(tmp_path: Path) -> None:
    write(
        tmp_path, 'if [ "$x" = 1 ]; then sleep 1; else i=0; while [ $i -lt 200000 ]; do i=$((i+1)); done; times > seconds; fi'
    )
    with opened("command", tmp_path, command=COMMAND) as session:
        assert session.evaluate({"x": 1}).cpu_seconds < 0.2
        busy = session.evaluate({"x": 2}).cpu_seconds
        seconds = float((scratch_of(session).work / "seconds").read_text().split()[0].removeprefix("0m").removesuffix("s"))
    assert seconds <= busy < seconds + 0.3


def test_a_command_that_vanishes_costs_its_runs(tmp_path: Path) -> None:
    write(tmp_path)
    with opened("command", tmp_path, command=COMMAND) as session:
        (tmp_path / "run.sh").unlink()
        assert "cannot be started" in lost(session, {"x": 1}, Breakdown.ERROR)


def test_the_scratch_folder_is_removed(tmp_path: Path) -> None:
    write(tmp_path)
    with opened("command", tmp_path, command=COMMAND) as session:
        session.evaluate({"x": 2})
        folder = scratch_of(session).folder
        assert json.loads((folder / "scenario.json").read_text()) == {"k": 3}
    until(lambda: not folder.exists())


@pytest.mark.parametrize("kind", VERSIONS)
def test_kinds_have_versions(kind: str) -> None:
    assert simulator_of({"kind": kind, "controller": {"kind": "fmu"}}).version == VERSIONS[kind]
