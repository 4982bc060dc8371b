"""A user's simulator that attacks its neighbours, copied into a bundle by tests. Bounded, in case that nothing holds it.

The scenario's data say where and how much: `mark` (a word in names of files and processes that are left), `home`, `cache`
(folders), `secret` (a file), `server` (a process), `url`, `port`, `others` (addresses), `sockets` (patterns of Unix
sockets), `shared` (a file in /dev/shm), `elsewhere` (the home of another server), `doublings` (of processes), `memory_mb`, `disk_mb`.
"""

import atexit
import contextlib
import ctypes
import fcntl
import mmap
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

Data = Mapping[str, Any]
SLEEPER = [sys.executable, "-S", "-c", "import time; time.sleep(600)"]


def fork_bomb(data: Data) -> None:
    for _ in range(data["doublings"]):
        try:
            if os.fork() == 0:
                os.setsid()
        except OSError:  # no more processes for anyone here
            break
    time.sleep(600)


def daemon(data: Data) -> None:
    subprocess.run(
        [sys.executable, "-S", "-c", f"import os, subprocess; os.setsid(); subprocess.Popen({[*SLEEPER, data['mark']]!r})"],
        check=True,
    )


def memory_of_one(_data: Data) -> None:
    hold = [bytearray(50 << 20) for _ in range(40)]
    time.sleep(len(hold) * 600)


def memory_without_end(data: Data) -> None:
    hold = [bytearray(b"1") * (10 << 20) for _ in range(data["memory_mb"] // 10)]
    time.sleep(len(hold) * 600)


def memory_of_many(_data: Data) -> None:
    for _ in range(3):
        if os.fork() == 0:
            break
    hold = bytearray(b"1") * (150 << 20)
    time.sleep(len(hold))


def memory_that_is_shared(_data: Data) -> None:
    hold = mmap.mmap(-1, 600 << 20)
    for _ in range(30):
        hold.write(bytes(20 << 20))
    time.sleep(600)


def hang(_data: Data) -> None:
    for number in set(signal.Signals) - {signal.SIGKILL, signal.SIGSTOP}:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_BLOCK, set(signal.Signals))
    time.sleep(600)


def flood(_data: Data) -> None:
    for _ in range(2000):
        os.write(1, b"out" * 10_000)
        os.write(2, b"\x1b]0;owned\x07\x9b31m" * 3000)
    time.sleep(600)


def fills_the_disk_with_small_files(_data: Data) -> None:
    folder = Path("small")
    folder.mkdir(exist_ok=True)
    for number in range(12_000):
        (folder / str(number)).write_bytes(bytes(1))
    time.sleep(600)


def fills_the_disk_with_a_large_file(data: Data) -> None:
    _fill(Path("large"), data["disk_mb"])
    time.sleep(600)


def nests_folders(_data: Data) -> None:
    """Deeper than a recursion of Python, without making any path too long: the next start empties the folder."""
    for _ in range(1_500):
        Path("d").mkdir()
        os.chdir("d")
    os._exit(0)


def _fill(path: Path, most_mb: int) -> None:
    """Writes until no room is left, and keeps what was written."""
    with path.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        for _ in range(most_mb):
            file.write(bytes(1 << 20))


def _one_of(attempts: Iterable[Callable[[], object]]) -> None:
    """Returns when an attempt succeeds. Raises the last refusal if none does."""
    refusal: OSError | None = None
    for attempt in attempts:
        try:
            attempt()
        except OSError as error:
            refusal = error
        else:
            return
    if refusal is not None:
        raise refusal


def writes_outside(data: Data) -> None:
    folders = ("/", "/etc", "/var/tmp", sys.prefix, data["home"], data["cache"], "/tmp")
    _one_of(Path(folder, data["mark"]).touch for folder in folders)


def answers_for_others(_data: Data) -> None:
    for descriptor in range(3, 64):
        for number in range(100):
            try:
                os.write(descriptor, b'{"id": %d, "measures": {"y": -1.0}}\n' % number)
            except OSError:
                break
    time.sleep(0.2)


def null_pointer(_data: Data) -> None:
    ctypes.string_at(0)


def leaves_at_once(_data: Data) -> None:
    os._exit(0)


def ends_with_a_crash(_data: Data) -> None:
    atexit.register(lambda: ctypes.string_at(0))


class _Crashing:
    def __del__(self) -> None:
        ctypes.string_at(0)


def crashes_when_collected(_data: Data) -> None:
    vars(sys)["kept"] = _Crashing()


class _Unprintable(BaseException):
    def __str__(self) -> str:
        raise ValueError

    __repr__ = __str__


def unprintable_error(_data: Data) -> None:
    raise _Unprintable


def overwrites_the_database(data: Data) -> None:
    with Path(data["home"], "drivecal.db").open("r+b") as file:
        file.write(bytes(4096))


def holds_up_the_database(data: Data) -> None:
    with Path(data["home"], "drivecal.db.queue").open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        time.sleep(600)


def reads_the_secret(data: Data) -> None:
    raise RuntimeError(Path(data["secret"]).read_text())


def reads_the_environment(data: Data) -> None:
    own = f"HOME={os.environ['HOME']}\0".encode()  # also in what earlier attacks of the same session have left
    for process in Path("/proc").glob("[0-9]*"):  # workers and its own keeper among them
        with contextlib.suppress(OSError):
            if (read := (process / "environ").read_bytes()) and own not in read:
                raise RuntimeError(process)
    raise RuntimeError(Path(f"/proc/{data['server']}/environ").read_text())


def _sockets(data: Data) -> list[str]:
    return [str(path) for pattern in data["sockets"] for path in Path("/").glob(pattern.removeprefix("/"))]


def _connect(path: str, kind: socket.SocketKind) -> None:
    with socket.socket(socket.AF_UNIX, kind) as end:
        end.connect(path)


def connects_to_local_sockets(data: Data) -> None:
    kinds = (socket.SOCK_STREAM, socket.SOCK_SEQPACKET, socket.SOCK_DGRAM)
    _one_of(partial(_connect, path, kind) for path in _sockets(data) for kind in kinds)


def sends_to_local_sockets(data: Data) -> None:
    for path in _sockets(data):
        socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)[0].sendto(b"1", path)


def overwrites_shared_memory(data: Data) -> None:
    with Path(data["shared"]).open("r+b") as file:
        file.write(b"2")


def changes_attributes(data: Data) -> None:
    home = Path(data["home"])
    changes: list[Callable[[], None]] = [
        lambda: home.chmod(0o755),
        lambda: os.chown(home, os.getuid(), os.getgid()),
        lambda: os.utime(home, (1, 1)),
        lambda: os.setxattr(home, "user.x", b"1"),
    ]
    _one_of(changes)


def reads_the_secret_of_another_server(data: Data) -> None:
    raise RuntimeError(Path(data["elsewhere"], "push.secret").read_text())


def writes_to_the_cache(data: Data) -> None:
    Path(data["cache"], "0" * 64).mkdir()


def kills_the_server(data: Data) -> None:
    os.kill(data["server"], signal.SIGTERM)


def kills_everything(_data: Data) -> None:
    os.kill(-1, signal.SIGCONT)  # as harmless as a signal can be; a confined process reaches itself only
    os.kill(os.getppid(), signal.SIGCONT)


def pushes_a_problem(data: Data) -> None:
    request = urllib.request.Request(f"{data['url']}/api/v1/problems", b"PK", {"Content-Type": "application/zip"})
    urllib.request.urlopen(request, timeout=5)


def listens(data: Data) -> None:
    server = socket.socket()
    server.bind(("127.0.0.1", data["port"]))
    server.listen()
    subprocess.Popen([*SLEEPER, data["mark"]], pass_fds=[server.fileno()])


def opens_sockets(data: Data) -> None:
    sockets = [socket.create_server(("", 0)) for _ in range(200)]
    subprocess.Popen([*SLEEPER, data["mark"]], pass_fds=[server.fileno() for server in sockets])


def reaches_others(data: Data) -> None:
    _one_of(partial(socket.create_connection, tuple(address), timeout=1) for address in data["others"])


ATTACKS: dict[str, Callable[[Data], None]] = {
    name: value
    for name, value in list(globals().items())
    if name.islower() and not name.startswith("_") and getattr(value, "__module__", "") == __name__
}


def evaluate(parameters: Mapping[str, Any], data: Data) -> dict[str, float]:
    """Attacks and answers 1, or answers 0 at once."""
    if parameters["attack"] == "none":
        return {"y": 0.0}
    ATTACKS[parameters["attack"]](data)
    return {"y": 1.0}
