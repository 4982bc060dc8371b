"""Simulators of kind `process`: the protocol, its faults, and what a fault costs."""

import contextlib
import errno
import json
import os
import pickle
import time
from pathlib import Path
from unittest.mock import Mock

import psutil
import pytest
from tests.support.serve import until
from tests.support.simulators import DECLARED, PYTHON, hung, lost, opened, scratch_of, served, write_script, write_server

from drivecal.adapters import kinds, pipes, process
from drivecal.adapters.environment import GRANTED, environment
from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins import simulators
from drivecal.plugins.simulators import BusyError, NoMeasuresError

FAULTS = {
    "crash": ("os.abort()", Breakdown.CRASH, "SIGABRT"),
    "exit": (
        "sys.stderr.write('first\\nno licence\\n'); sys.exit(3)",
        Breakdown.CRASH,
        "exit code 3; its last messages: first | no licence",
    ),
    "no JSON": ("print('Simulation finished', flush=True)", Breakdown.ERROR, "not JSON: Simulation finished"),
    "no object": ("print('[1]', flush=True)", Breakdown.ERROR, "not a JSON object"),
    "deep JSON": ("print('[' * 100000, flush=True)", Breakdown.ERROR, "not JSON"),
    "no UTF-8": ("os.write(1, b'\\xff\\xfe\\n')", Breakdown.ERROR, "not JSON"),
    "other id": ("answer(id=request['id'] - 1, measures=dict(y=1.0))", Breakdown.ERROR, "id"),
    "two answers": ("os.write(1, b'{\"id\": %d}\\n' % request['id'] * 2)", Breakdown.ERROR, "more than one line"),
    "long line": ("os.write(1, b'[' + b'1,' * 50_000_000)", Breakdown.ERROR, "more than 16 MB"),
    "flood": ("while True: os.write(1, b'x' * 60_000)", Breakdown.ERROR, "more than 16 MB"),
    "flood of lines": ("while True: os.write(1, b'[]\\n' * 20_000)", Breakdown.ERROR, "not a JSON object"),
    "closed output": ("os.close(1); time.sleep(600)", Breakdown.ERROR, "closed its standard output"),
    "out of memory": ("bytearray(4_000_000_000)", Breakdown.MEMORY, "MemoryError"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_costs_its_run_only(tmp_path: Path, name: str) -> None:
    body, breakdown, detail = FAULTS[name]
    with served(tmp_path, f"if x == 1.0:\n    {body}\n") as session:
        assert session.evaluate({"x": 0.0}).measures == {"y": 0.0}
        for _ in range(2):
            assert detail in lost(session, {"x": 1.0}, breakdown)
            assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}


def test_a_start_without_enough_descriptors_leaves_none_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with served(tmp_path) as session:
        session.evaluate({"x": 0.0})
        session._stop()
        before = psutil.Process().num_fds()
        monkeypatch.setattr(os, "pipe", Mock(side_effect=[os.pipe(), os.pipe(), OSError(errno.EMFILE, "too many open files")]))
        with pytest.raises(OSError, match="too many"):
            session.evaluate({"x": 1.0})
        assert psutil.Process().num_fds() == before


@pytest.mark.slow
def test_many_runs_and_faults_leave_nothing_open(tmp_path: Path) -> None:
    with served(tmp_path, "if x == 1.0:\n    os.abort()\nif x == 2.0:\n    answer(id=0)") as session:
        session.evaluate({"x": 0.0})
        before = psutil.Process().num_fds()
        for number in range(300):
            if number % 30 == 0:
                lost(session, {"x": 1.0}, Breakdown.CRASH)
                lost(session, {"x": 2.0}, Breakdown.ERROR)
            assert session.evaluate({"x": 10.0 + number}).measures == {"y": 20.0 + 2 * number}
        assert psutil.Process().num_fds() <= before


def test_a_process_is_busy_for_a_run_or_at_its_start_with_its_reason(tmp_path: Path) -> None:
    with served(tmp_path, 'if x == 1.0:\n    answer(id=request["id"], busy="no licence"); continue') as session:
        with pytest.raises(BusyError, match="no licence"):
            session.evaluate({"x": 1.0})
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}
    with pytest.raises(BusyError, match="both in use"), served(tmp_path, start="answer(busy='both in use'); return") as session:
        session.evaluate({"x": 2.0})


def test_a_hang_costs_its_run_only(tmp_path: Path) -> None:
    with served(tmp_path, "if x == 1:\n    sys.stderr.write('stuck')\n    sys.stderr.flush()\n    time.sleep(600)") as session:
        session.evaluate({"x": 0.0})
        shown = hung(session, {"x": 1.0}, 2.0)
        assert all(part in shown for part in ("after 2 s", "simulator.timeout", "problem.yaml", "its last messages: stuck"))
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}


def test_an_answer_that_is_there_counts_if_the_worker_was_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As by a signal, or by a machine that sleeps."""
    with served(tmp_path, timeout=0.5) as session:
        step = pipes.Pipes._step

        def stopped(self: pipes.Pipes, deadline: float, seconds: float) -> None:
            until(lambda: self._poll.poll(0) and time.monotonic() > deadline)
            step(self, deadline, seconds)

        with monkeypatch.context() as patch:
            patch.setattr(pipes.Pipes, "_step", stopped)
            assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}


def test_a_flood_of_messages_neither_blocks_nor_changes_a_run(tmp_path: Path) -> None:
    with served(tmp_path, "os.write(2, b'warning ' * 2_000_000)", ending="os.write(2, b'x' * 1_000_000)") as session:
        for x in range(3):
            assert session.evaluate({"x": float(x)}).measures == {"y": 2.0 * x}


@pytest.mark.slow
def test_an_endless_flood_of_messages_is_a_hang(tmp_path: Path) -> None:
    with served(tmp_path, "while x == 1.0: os.write(2, b'warning ' * 1000)") as session:
        assert "warning" in hung(session, {"x": 1.0}, 5.0)
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}


def test_a_request_holds_scenario_data_parameters_and_seed(tmp_path: Path) -> None:
    body = "open(os.path.join(os.environ['HOME'], 'log'), 'a').write(json.dumps([greeting, request]) + '\\n')"
    with served(tmp_path, f"{body}\nanswer(id=request['id'], measures=dict(y=1.0))\ncontinue") as session:
        session.evaluate({"x": 1.5, "n": 3, "mode": "eco"})
        session.evaluate({"x": 2.5}, series=True)
        (log,) = Path(scratch_of(session).folder).rglob("log")
        rows = [json.loads(line) for line in log.read_text().splitlines()]
    head = {"scenario": "S", "data": {"k": 3}, "seed": 1}
    assert rows == [
        [{"drivecal": 1, "problem": "trial"}, {"id": 1, **head, "parameters": {"x": 1.5, "n": 3, "mode": "eco"}}],
        [{"drivecal": 1, "problem": "trial"}, {"id": 2, **head, "parameters": {"x": 2.5}, "series": True}],
    ]


def test_a_wrong_answer_costs_its_run_and_no_restart(tmp_path: Path) -> None:
    wrong = [
        ("measures=dict(y=float('nan'))", "y is not finite"),
        ("measures=dict(y=10**400)", "y is not finite"),
        ("measures=dict(y='1')", "y is not a number"),
        ("measures=dict(y=True)", "y is not a number"),
        ("measures=dict()", "lacks measures: y"),
        ("measures=dict(y=1, z=2)", "not declared: z"),
        ("measures=[1]", "no object `measures`"),
        ("failure=3", "`failure` is not the name"),
        ("failure='hang'", "hang means that a run has no result"),
        ("failure='crashed', measures=dict(z=1)", "not declared: z"),
        ("error='licence server away'", "licence server away"),
    ]
    answers = "".join(
        f"if x == {number}.5:\n    answer(id=request['id'], {fields})\n    continue\n"
        for number, (fields, _) in enumerate(wrong)
    )
    with served(tmp_path, f"{answers}x = x * runs") as session:
        for number, (_, detail) in enumerate(wrong):
            assert detail in lost(session, {"x": number + 0.5}, Breakdown.ERROR)
            assert session.evaluate({"x": 3.0}).measures == {"y": 12.0 * (number + 1)}  # another run of the same process


def test_an_error_of_null_is_none(tmp_path: Path) -> None:
    body = "answer(id=request['id'], error=None, measures=dict(y=1.0))\ncontinue"
    with served(tmp_path, body, start="answer(ready=True, error=None)\nreturn") as session:
        assert session.evaluate({"x": 1.0}).measures == {"y": 1.0}


@pytest.mark.slow("time.sleep(600)")
@pytest.mark.parametrize(
    "fault",
    [
        "os.abort()",
        "os.write(1, b'nonsense\\n')",
        "time.sleep(600)",
        "answer(id=request['id'], measures=dict(y=4.0))\nos._exit(0)",
    ],
)
def test_a_fault_leaves_no_files_to_the_next_process(tmp_path: Path, fault: str) -> None:
    """As a lock of a program that was killed, or a change of what its driver has unpacked."""
    start = """
for folder in ('.', os.environ['HOME'], os.environ['TMPDIR']):
    if os.path.exists(os.path.join(folder, 'lock')): sys.exit('locked')
"""
    body = f"for folder in ('.', os.environ['HOME']): open(os.path.join(folder, 'lock'), 'x').close()\n{fault}"
    with served(tmp_path, "if x == 1.0:\n    " + body.replace("\n", "\n    "), start) as session:
        (session._scratch.folder / "packages").mkdir()
        for _ in range(2):
            with contextlib.suppress(NoMeasuresError):
                session._timeout = 2.0
                session.evaluate({"x": 1.0})
            session._timeout = 60.0
            until(lambda: session._pipes is None or not session._pipes.is_fresh())
            assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}
        assert not (session._scratch.folder / "packages").exists()


def test_time_series_are_returned_on_request_only(tmp_path: Path) -> None:
    body = "answer(id=request['id'], measures=dict(y=1.0), series=dict(t=[0, 0.5]) if x else dict(u=[1]))\ncontinue"
    with served(tmp_path, body) as session:
        assert session.evaluate({"x": 1.0}, series=True).series == {"t": [0.0, 0.5]}
        assert session.evaluate({"x": 1.0}).series == {}
        with pytest.raises(NoMeasuresError, match=r"\bu\b"):
            session.evaluate({"x": 0.0}, series=True)


UNASKED = """
import array, fcntl, termios
unread = array.array('i', [1])
while unread[0]: fcntl.ioctl(1, termios.FIONREAD, unread)
print('goodbye', flush=True)
continue"""


@pytest.mark.parametrize("between", [UNASKED, "os._exit(0)"], ids=["a line", "its end"])
def test_what_a_process_does_between_two_runs_costs_no_run(tmp_path: Path, between: str) -> None:
    """A line is no answer then: the process is replaced."""
    with served(tmp_path, f"answer(id=request['id'], measures=dict(y=1.0))\n{between}") as session:
        for _ in range(3):
            assert session.evaluate({"x": 1.0}).measures == {"y": 1.0}
            until(lambda: not session._pipes.is_fresh())


@pytest.mark.slow
def test_a_process_that_does_not_read_a_large_request_is_a_hang(tmp_path: Path) -> None:
    with served(tmp_path, "if x == 1.0: time.sleep(600)") as session:
        session._head = session._head.replace("3}", '3, "large": "' + "x" * 3_000_000 + '"}')
        assert session.evaluate({"x": 0.0}).measures == {"y": 0.0}
        hung(session, {"x": 1.0})
        assert session.evaluate({"x": 0.0}).measures == {"y": 0.0}


@pytest.mark.parametrize(
    ("start", "breakdown", "detail"),
    [
        ("sys.exit('cannot load libfoo.so')", Breakdown.CRASH, "cannot load libfoo.so"),
        ("print('MySim 1.0', flush=True)", Breakdown.ERROR, "not JSON: MySim 1.0"),
        ("answer(ready=False)\nreturn", Breakdown.ERROR, "ready"),
        ("time.sleep(600)", Breakdown.HANG, "simulator.timeout"),
    ],
)
def test_a_start_that_fails_costs_a_run_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, start: str, breakdown: Breakdown, detail: str
) -> None:
    seconds = 0.5 if breakdown is Breakdown.HANG else 60.0
    monkeypatch.setattr(simulators, "START_SECONDS", seconds)
    with served(tmp_path, start=start, timeout=seconds) as session:
        for _ in range(2):
            shown = lost(session, {"x": 1.0}, breakdown)
            assert "does not start" in shown
            assert detail in shown


@pytest.mark.parametrize(
    ("command", "detail"),
    [
        ("./nothing", "does not exist"),
        ("no-such-program", "PATH"),
        ("./plain", "chmod"),
        ("./broken", "/no/such/interpreter"),
        ("./windows", "Windows"),
        ("./unknown", "cannot be started"),
    ],
)
def test_a_command_that_cannot_run_cannot_be_opened(tmp_path: Path, command: str, detail: str) -> None:
    (tmp_path / "plain").write_text("")
    write_script(tmp_path / "broken", "#!/no/such/interpreter\n")
    write_script(tmp_path / "windows", "#!/bin/sh\r\n")
    write_script(tmp_path / "unknown", "neither script nor program\n")
    with pytest.raises(UnavailableError, match=detail), opened("process", tmp_path, command=[command]):
        pass


def test_a_process_works_beside_links_to_the_bundle_and_leaves_it_as_it_is(tmp_path: Path) -> None:
    bundle = tmp_path / "bundle"
    bundle.mkdir()
    (bundle / "factor").write_text("7")
    (bundle / "problem.yaml").write_text("problem: trial")
    before = sorted(bundle.rglob("*"))
    body = "x = float(open('factor').read()) + os.path.exists('problem.yaml')\nopen('out', 'w').write('1')\nos.mkdir('deep')"
    with served(bundle, body) as session:
        assert session.evaluate({"x": 1.0}).measures == {"y": 14.0}
        folder = scratch_of(session).folder
        assert (folder / "work" / "out").is_file()
    assert sorted(bundle.rglob("*")) == [*before, bundle / "sim.py"]
    assert not folder.exists()


def test_closing_twice_and_after_faults_leaves_nothing(tmp_path: Path) -> None:
    before = {path.name for path in Path("/proc/self/fd").iterdir()}
    with served(tmp_path, "os.abort()", ending="while True: pass") as session:
        lost(session, {"x": 1.0}, Breakdown.CRASH)
        session.close()
    assert {path.name for path in Path("/proc/self/fd").iterdir()} <= before


def test_a_process_may_end_by_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    monkeypatch.setenv(GRANTED, str(tmp_path))
    monkeypatch.setattr(process, "QUIT_SECONDS", 60.0)
    with served(tmp_path, ending=f"open({str(out)!r}, 'w').write('saved')"):
        pass
    assert out.read_text() == "saved"


def test_the_environment_holds_no_secrets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inherited = {
        "PATH": "/bin", "LM_LICENSE_FILE": "27000@host", "DRIVECAL_DATABASE_URL": "x", "RAY_AUTH_TOKEN_PATH": "x", "PGPASSWORD": "x",
        "AWS_SECRET_ACCESS_KEY": "x", "GITHUB_TOKEN": "x", "PROXY": "http://user:word@host", "PYTHONPATH": "x", "HOME": "/root",
        "OMP_NUM_THREADS": "4",
        "INTERNAL_CONFIG": "x", "LANG": "C.UTF-8", "LC_ALL": "C.UTF-8", "TZ": "UTC", "LD_LIBRARY_PATH": "/opt/lib", "PYTHONHASHSEED": "0",
        "MATLAB_HOME": "/opt/matlab", "GUROBI_LICENSE": "/opt/gurobi.lic",
    }  # fmt: skip
    monkeypatch.setattr(os, "environ", inherited)
    kept = environment(tmp_path, ["MATLAB_HOME", "HOME", "NOT_SET"])
    assert kept["HOME"] == kept["TMPDIR"] == str(tmp_path)
    assert kept["OMP_NUM_THREADS"] == "4"
    common = {"PATH", "LANG", "LC_ALL", "TZ", "LD_LIBRARY_PATH", "PYTHONHASHSEED", "LM_LICENSE_FILE", "GUROBI_LICENSE"}
    assert set(kept) & set(inherited) == common | {"HOME", "OMP_NUM_THREADS", "MATLAB_HOME"}


def test_a_process_gets_the_variables_that_its_manifest_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MATLAB_HOME", "/opt/matlab")
    monkeypatch.setenv("DRIVECAL_TOKEN", "secret")
    body = "x = float('MATLAB_HOME' in os.environ) + 2 * float('DRIVECAL_TOKEN' in os.environ)"
    with served(tmp_path, body, environment=["MATLAB_HOME"]) as session:
        assert session.evaluate({"x": 1.0}).measures == {"y": 2.0}
    with served(tmp_path, body, environment=None) as session:
        assert session.evaluate({"x": 1.0}).measures == {"y": 0.0}


def test_the_error_survives_pickling() -> None:
    error = pickle.loads(pickle.dumps(NoMeasuresError(Breakdown.HANG, "late", 1.5)))
    assert (error.breakdown, str(error), error.cpu_seconds) == (Breakdown.HANG, "late", 1.5)


def test_the_tail_is_the_end_of_the_messages(tmp_path: Path) -> None:
    with served(tmp_path, "os.write(2, b'x' * 9000 + b'\\nlast\\n'); sys.exit(1)") as session:
        assert lost(session, {"x": 1.0}, Breakdown.CRASH).endswith("x | last")
        assert len(lost(session, {"x": 1.0}, Breakdown.CRASH)) < pipes.LONGEST_TAIL


def test_a_traceback_is_shown_with_its_location_and_its_error(tmp_path: Path) -> None:
    body = "def gain(p):\n    return p['Kp'] + 1\nif x == 2.0:\n    raise ValueError('one\\ntwo\\nthree\\nfour')\ngain({})"
    with served(tmp_path, body) as session:
        shown, of_many_lines = (lost(session, {"x": x}, Breakdown.CRASH) for x in (1.0, 2.0))
    lines = (tmp_path / "sim.py").read_text().splitlines()
    line, raised = (next(at for at, text in enumerate(lines, 1) if words in text) for words in ("p['Kp']", "raise"))
    assert f'sim.py", line {line}' in shown
    assert of_many_lines.endswith(f'sim.py", line {raised} | three | four')
    assert shown.endswith("return p['Kp'] + 1 | KeyError: 'Kp'")
    assert "^" not in shown


@pytest.mark.parametrize("ready", [True, False])
def test_an_unflushed_answer_is_named_as_a_cause(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, ready: bool) -> None:
    if not ready:
        monkeypatch.setattr(simulators, "START_SECONDS", 0.5)
    held = "sys.stdout.write('{\"ready\": true}\\n'); time.sleep(600)"
    with served(tmp_path, held if ready else "", start="pass" if ready else held, timeout=0.5) as session:
        assert kinds.UNFLUSHED in lost(session, {"x": 1.0}, Breakdown.HANG)


def test_a_program_on_the_path_can_be_used(tmp_path: Path) -> None:
    write_server(tmp_path)
    with opened("process", tmp_path, DECLARED, command=["env", PYTHON, "sim.py"]) as session:
        assert session.evaluate({"x": 1.0}).measures == {"y": 2.0}
