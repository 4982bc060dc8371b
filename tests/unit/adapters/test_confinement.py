"""Landlock keeps a simulator from harming its neighbours and allows it everything else that it needs."""

import ctypes
import os
import socket
from contextlib import ExitStack
from pathlib import Path

import pytest
from tests.support.simulators import lost, opened, scratch_of, served, write_server

from drivecal.adapters import confinement, keeper
from drivecal.adapters.environment import GRANTED, Scratch
from drivecal.adapters.seclusion import Seclusion
from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import Declared

confining = pytest.mark.skipif(confinement.version() == 0, reason="this kernel has no Landlock")

FORBIDDEN = {
    "create": "open('{outside}/new', 'w')",
    "overwrite": "open('{outside}/file', 'w')",
    "append": "open('{outside}/file', 'a')",
    "remove": "os.remove('{outside}/file')",
    "rename": "os.rename('{outside}/file', '{outside}/other')",
    "take": "os.rename('{outside}/file', 'taken')",
    "folder": "os.mkdir('{outside}/deep')",
    "link": "os.symlink('/', '{outside}/link')",
    "hard_link": "os.link('{outside}/file', 'hard')",
    "socket": "socket.socket(socket.AF_UNIX).bind('{outside}/socket')",
    "bundle": "open('deep/data', 'w')",
    "beside": "open(os.path.join(os.path.dirname(os.path.dirname(os.getcwd())), 'drivecal-run-x'), 'w')",
    "secret": "open('{home}/push.secret').read()",
    "database": "open('{home}/drivecal.db', 'rb').read(1)",
    "secret_by_link": "(os.symlink('{home}', 'way'), open('way/push.secret').read())",
    "secret_by_root": "open('/proc/self/root{home}/push.secret').read()",
    "tokens": "open('{outside}/tokens').read()",
    "terminal": "open('{terminal}', 'w')",
    "keyboard": "os.open('{terminal}', os.O_RDONLY | os.O_NOCTTY)",
    "kernel_log": "open('/dev/kmsg', 'w')",
    "environment": "open('/proc/%d/environ' % os.getppid(), 'rb').read()",
    "memory": "open('/proc/%d/mem' % os.getppid(), 'rb').read(0)",
    "debug": "check(ctypes.CDLL(None, use_errno=True).ptrace(16, os.getppid(), 0, 0) == 0)",  # PTRACE_ATTACH
    "limit": "resource.prlimit(os.getppid(), resource.RLIMIT_CORE, (0, 0))",
    "limit_worker": "resource.prlimit({worker}, resource.RLIMIT_CORE, (0, 0))",
    "processors": "(os.sched_setaffinity(os.getppid(), [0]), check(os.sched_getaffinity(os.getppid()) == set([0])))",
    "policy": "(os.sched_setscheduler(os.getppid(), 3, os.sched_param(0)), check(os.sched_getscheduler(os.getppid()) == 3))",
    "priority": "os.setpriority(os.PRIO_PROCESS, os.getppid(), os.getpriority(os.PRIO_PROCESS, os.getppid()))",
    "priority_of_all": "os.setpriority(os.PRIO_USER, 0, os.getpriority(os.PRIO_USER, 0))",
    "abstract_socket": "dial({abstract!r})",
    "socket_by_path": "dial('{outside}/listening')",
    "datagram_by_path": "socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)[0].sendto(b'1', '{outside}/datagrams')",
    "raw_pair": "socket.socketpair(socket.AF_UNIX, socket.SOCK_RAW)",
    "descriptor_of_worker": "os.open('/proc/{worker}/fd/0', os.O_RDONLY)",
    "stolen_descriptor": "check(ctypes.CDLL(None).syscall(438, os.pidfd_open({worker}), 0, 0) >= 0)",
    "host_socket": "socket.socket(socket.AF_VSOCK)",
    "ring": "check(ctypes.CDLL(None).syscall(425, 1, ctypes.byref((ctypes.c_uint32 * 30)())) >= 0)",
    "keyring": "check(ctypes.CDLL(None).syscall(250, 0, -4, 1) > 0)",
    "memory_of_others": "open('{shared}').read()",
    "memory_of_others_changed": "open('{shared}', 'r+')",
    "segment_of_others": "check(ctypes.CDLL(None).shmget({key}, 0, 0) >= 0)",
    "mount": "check(ctypes.CDLL(None, use_errno=True).mount(b'none', os.getcwd().encode(), b'tmpfs', 0, None) == 0)",
}
LATER = {"truncate": "os.truncate('{outside}/file', 0)"}
SCOPED = {"signal": "os.kill(os.getppid(), 0)", "signal_worker": "os.kill({worker}, 0)"}
SECLUDED = {
    "mode": "os.chmod('{outside}/file', 0o666)",
    "mode_by_descriptor": "os.fchmod(os.open('{outside}/file', os.O_RDONLY), 0o666)",
    "mode_of_folder": "os.chmod('{outside}', 0o777)",
    "owner": "os.chown('{outside}/file', os.getuid(), os.getgid())",
    "times": "os.utime('{outside}/file', (1, 1))",
    "attribute": "os.setxattr('{outside}/file', 'user.x', b'1')",
    "mode_of_bundle": "os.chmod('deep/data', 0o666)",
}
OWN_MEMORY = {
    "semaphore": "__import__('multiprocessing').Lock()",
    "shared_memory": "(m := __import__('multiprocessing.shared_memory').shared_memory.SharedMemory(create=True, size=9), m.unlink())",
    "left_memory": "os.close(os.open('/dev/shm/left', os.O_CREAT | os.O_EXCL | os.O_RDWR))",
    "segment": "check(ctypes.CDLL(None).shmget({key}, 9, 0o1600) >= 0)",
}
ALLOWED = {
    "work": "open('file', 'w').write('1')",
    "temporary": "__import__('tempfile').TemporaryFile().write(b'1')",
    "move": "(os.mkdir('sub'), open('moved', 'w'), os.rename('moved', 'sub/moved'))",
    "device": "open('/dev/null', 'w').write('1')",
    "random": "open('/dev/urandom', 'rb').read(1)",
    "own_limit": "(resource.setrlimit(resource.RLIMIT_CORE, (0, 0)), resource.prlimit(os.getpid(), resource.RLIMIT_CORE, (0, 0)))",
    "look_at_limits": "resource.prlimit(os.getppid(), resource.RLIMIT_CORE)",
    "own_processors": "[os.sched_setaffinity(number, os.sched_getaffinity(0)) for number in (0, os.getpid())]",
    "own_priority": "(os.nice(0), os.setpriority(os.PRIO_PROCESS, os.getpid(), os.getpriority(os.PRIO_PROCESS, 0)))",
    "own_policy": "os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))",
    "program": "check(subprocess.run(['sh', '-c', 'echo x > file2; kill $$']).returncode == -15)",
    "system": "open('/etc/passwd').read()",
    "module": "__import__('decimal')",
    "bundle_file": "open('deep/data').read()",
    "listen": "(s := socket.socket(), s.bind(('127.0.0.1', 0)), s.listen())",
    "pair": "(p := socket.socketpair(), p[0].sendall(b'1'), check(p[1].recv(1) == b'1'))",
    "own_mode": "(open('own', 'w'), os.chmod('own', 0o755), os.utime('own', (1, 1)))",
    "manager": "[__import__('multiprocessing.managers').managers.SyncManager(('127.0.0.1', 0)).start()]",
    "standard_error": "check(os.system('echo message > /dev/stderr') == 0)",
}


def attempts(codes: dict[str, str], **places: object) -> str:
    """Returns a body that tries each code and answers 1 for each that works."""
    filled = {name: code.format(**places) for name, code in codes.items()}
    return f"""
import ctypes, resource, socket
def check(condition):
    if not condition: raise OSError
def dial(address):
    with socket.socket(socket.AF_UNIX) as dialled: dialled.connect(address)
worked = {{}}
for name, code in {filled!r}.items():
    try:
        eval(code)
    except OSError:
        worked[name] = 0.0
    else:
        worked[name] = 1.0
answer(id=request["id"], measures=worked)
continue
"""


@confining
def test_a_simulator_changes_its_own_folders_only_and_reads_no_secrets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bundle, outside, home = tmp_path / "bundle", tmp_path / "outside", tmp_path / "home"
    for folder in (bundle / "deep", outside, home):
        folder.mkdir(parents=True)
    for path in (bundle / "deep" / "data", outside / "file", home / "push.secret", home / "drivecal.db", outside / "tokens"):
        path.write_text("content")
    monkeypatch.setenv("DRIVECAL_HOME", str(home))
    monkeypatch.setenv("DRIVECAL_TOKENS_FILE", str(outside / "tokens"))
    is_secluded = Seclusion.make([], 1 << 20) is not None
    forbidden, allowed = dict(FORBIDDEN), dict(ALLOWED)
    forbidden, allowed = (forbidden | SECLUDED, allowed | OWN_MEMORY) if is_secluded else (forbidden | OWN_MEMORY, allowed)
    if confinement.version() >= confinement.TRUNCATION_SINCE:
        forbidden |= LATER
    if confinement.version() >= confinement.SCOPES_SINCE:
        forbidden |= SCOPED
    codes = forbidden | allowed
    abstract = f"\0drivecal-{os.getpid()}"
    listening = [socket.socket(socket.AF_UNIX, kind) for kind in (socket.SOCK_STREAM, socket.SOCK_STREAM, socket.SOCK_DGRAM)]
    for end, address in zip(listening, (abstract, str(outside / "listening"), str(outside / "datagrams")), strict=True):
        end.bind(address)
        if end.type == socket.SOCK_STREAM:
            end.listen()
    shared = Path(f"/dev/shm/drivecal-test-{os.getpid()}")
    shared.write_text("content")
    segment = ctypes.CDLL(None).shmget(os.getpid(), 9, 0o1600)
    terminal = os.openpty()
    places = {
        "outside": outside,
        "home": home,
        "worker": os.getpid(),
        "abstract": abstract,
        "shared": shared,
        "key": os.getpid(),
        "terminal": os.ttyname(terminal[1]),
    }
    command = write_server(bundle, attempts(codes, **places))
    before = sorted(tmp_path.rglob("*"))
    with opened("process", bundle, Declared("trial", tuple(codes)), command=command) as session:
        worked = session.evaluate({"x": 1.0}).measures
    for end in listening:
        end.close()
    shared.unlink()
    ctypes.CDLL(None).shmctl(segment, 0, None)
    for descriptor in terminal:
        os.close(descriptor)
    assert {name for name, success in worked.items() if success} == set(allowed)
    assert sorted(tmp_path.rglob("*")) == before
    assert (outside / "file").read_text() == "content"


@confining
def test_other_bundles_of_the_cache_cannot_be_read(tmp_path: Path) -> None:
    own, other = tmp_path / ("a" * 64), tmp_path / ("b" * 64)
    for folder in (own, other):
        folder.mkdir()
        (folder / "data").write_text("content")
    codes = {"own": f"open({str(own / 'data')!r}).read()", "other": f"open({str(other / 'data')!r}).read()"}
    command = write_server(own, attempts(codes))
    with opened("process", own, Declared("trial", tuple(codes)), command=command) as session:
        assert session.evaluate({"x": 1.0}).measures == {"own": 1.0, "other": 0.0}


@confining
def test_files_of_other_sessions_cannot_be_read(tmp_path: Path) -> None:
    """Sessions that are open, and sessions that begin later."""
    bundles = [tmp_path / name for name in ("own", "earlier", "later")]
    for bundle in bundles:
        bundle.mkdir()
    codes = {
        "own": "open('../packages').read()",
        "earlier": "open(open('earlier').read()).read()",
        "later": "open(open('later').read()).read()",
    }
    command = write_server(bundles[0], attempts(codes))
    with ExitStack() as stack:
        earlier = stack.enter_context(served(bundles[1]))
        session = stack.enter_context(opened("process", bundles[0], Declared("trial", tuple(codes)), command=command))
        later = stack.enter_context(served(bundles[2]))
        for name, other in (("earlier", earlier), ("later", later)):
            (scratch_of(other).folder / "packages").write_text("content")
            (scratch_of(session).work / name).write_text(str(scratch_of(other).folder / "packages"))
        (scratch_of(session).folder / "packages").write_text("content")
        measures = session.evaluate({"x": 1.0}).measures
        assert measures == {"own": 1.0, "earlier": 0.0, "later": 0.0}


def test_the_folder_of_sessions_is_private_and_not_another_users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    folder = tmp_path / f"drivecal-runs-{os.geteuid()}"
    bundle = tmp_path / "bundle"
    bundle.mkdir()
    folder.mkdir(mode=0o755)
    with served(bundle) as session:
        assert scratch_of(session).folder.parent == folder
        assert folder.stat().st_mode & 0o777 == 0o700
    folder.rmdir()
    folder.symlink_to(bundle)
    with pytest.raises(UnavailableError, match="TMPDIR"):
        Scratch(bundle)


@confining
def test_a_refusal_names_writable_folders_and_owners_grant_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tools = tmp_path / "tools"
    tools.mkdir()
    body = f"open({str(tools / 'cache')!r}, 'w').write('1')"
    with served(tmp_path, body) as session:
        assert GRANTED in lost(session, {"x": 1.0}, Breakdown.CRASH)
    monkeypatch.setenv(GRANTED, f"/nowhere:{tools}")
    with served(tmp_path, body) as session:
        assert session.evaluate({"x": 1.0}).measures == {"y": 2.0}
    assert (tools / "cache").read_text() == "1"


def test_a_machine_whose_owner_wants_no_confinement_has_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(GRANTED, "/")
    with served(tmp_path, f"open({str(tmp_path / 'out')!r}, 'w').write('1')") as session:
        assert session.evaluate({"x": 1.0}).measures == {"y": 2.0}


def test_a_child_is_the_first_that_a_machine_without_memory_kills(tmp_path: Path) -> None:
    with served(tmp_path, "x = float(open('/proc/self/oom_score_adj').read())") as session:
        assert session.evaluate({"x": 0.0}).measures == {"y": 2.0 * int(keeper.MOST_KILLABLE)}


def test_a_child_gains_no_privileges(tmp_path: Path) -> None:
    with served(tmp_path, "x = float('NoNewPrivs:\\t1' in open('/proc/self/status').read())") as session:
        assert session.evaluate({"x": 0.0}).measures == {"y": 2.0}


def test_a_kernel_without_landlock_confines_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(confinement, "version", lambda: 0)
    assert confinement.ruleset([str(tmp_path)]) is None


@confining
@pytest.mark.parametrize("known", range(1, 8))
def test_rules_suit_every_version_of_landlock(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, known: int) -> None:
    """A kernel takes the rules of all versions before its own."""
    if known > confinement.version():
        pytest.skip("this kernel is older")
    monkeypatch.setattr(confinement, "version", lambda: known)
    rules = confinement.ruleset([str(tmp_path)], [], [str(tmp_path / "hidden")])
    assert rules is not None
    os.close(rules)


@confining
def test_too_many_neighbours_of_a_hidden_file_leave_it_readable(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(confinement, "MOST_RULES", 1)
    assert confinement._beside({str(tmp_path / "hidden")}) == []
    monkeypatch.undo()
    (tmp_path / "beside").write_text("")
    beside = confinement._beside({str(tmp_path / "hidden")})
    assert str(tmp_path / "beside") in beside
    assert not any(tmp_path.is_relative_to(path) for path in beside)


@confining
def test_a_hidden_file_with_too_many_neighbours_leaves_others_hidden(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    crowded, quiet = tmp_path / "crowded" / "hidden", tmp_path / "quiet" / "hidden"
    for path in (crowded, quiet):
        path.parent.mkdir()
    needed = len(confinement._beside({str(quiet)}))
    for number in range(100):
        (crowded.parent / str(number)).write_text("")
    monkeypatch.setattr(confinement, "MOST_RULES", needed + 50)
    assert confinement._beside({str(crowded), str(quiet)}) == []
    assert confinement._affordable({str(crowded), str(quiet)}) == {str(quiet)}
    for path in (crowded, quiet):
        path.write_text("content")
    rules = confinement.ruleset([], [], [str(crowded), str(quiet)])
    child = os.fork()
    if child == 0:
        confinement.confine(rules)
        os._exit(_is_readable(crowded) + 2 * _is_readable(quiet))
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 1
    assert rules is not None
    os.close(rules)


def _is_readable(path: Path) -> bool:
    try:
        return path.read_text() == "content"
    except OSError:
        return False
