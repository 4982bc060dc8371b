"""Pipes to a running child: sends lines, receives lines, keeps the end of its messages, and names the cause if it fails."""

import contextlib
import os
import re
import select
import signal
import time

from drivecal.adapters.children import Children
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import BusyError, NoMeasuresError

BUSY = os.EX_TEMPFAIL
"""Exit code 75 of a command that takes no run for now, because a licence is in use, say."""
LONGEST_LINE = 16 << 20
"""Largest answer in bytes, time series included."""
LONGEST_TAIL = 4096
"""Bytes of standard error that are kept."""
RUN_LIMIT = "the limit of a run (`simulator.timeout` in problem.yaml, s); raise it if runs may take longer"
"""Origin of the time limit, for the message of a hang."""
TICK_SECONDS = 0.5
"""Longest time between two looks at the clock and at the child's processes."""
CLOSED_SECONDS = 1.0
"""Time for a child that has closed its standard output to end."""
LONGEST_SHOWN = 300
"""Characters of messages in an error."""
LONGEST_PATH = 100
"""Characters kept of the end of a file's path in a traceback."""
LONGEST_END = 10
"""Last lines of the messages among which the location of a traceback is searched."""
_PLACE = re.compile(r'File "(?P<file>[^"]+)", line (?P<line>\d+)')
_CHUNK = 1 << 18
_OUT_OF_MEMORY = (b"MemoryError", b"bad_alloc", b"annot allocate memory", b"ut of memory", b"OutOfMemory")


class Pipes:
    """A start of a child with pipes for its standard input, output and error. Every fault is a NoMeasuresError."""

    def __init__(self, children: Children, *, silent: bool = False) -> None:
        """Starts the child. `silent`: without standard input, and its standard output is kept as messages.

        Raises UnavailableError if its command cannot be run.
        """
        self._children, self._limit = children, RUN_LIMIT
        self._tail = b""
        self._received = bytearray()
        self._waiting = memoryview(b"")
        self._is_writing = False
        self._ended: int | None = None
        """Return code of the child."""
        self._stdin = self._stdout = self._stderr = -1
        with contextlib.ExitStack() as theirs:
            try:
                theirs_in, self._stdin = (os.open(os.devnull, os.O_RDONLY), -1) if silent else os.pipe()
                theirs.callback(os.close, theirs_in)
                self._stderr, theirs_err = os.pipe()
                theirs.callback(os.close, theirs_err)
                self._stdout, theirs_out = (-1, os.dup(theirs_err)) if silent else os.pipe()
                theirs.callback(os.close, theirs_out)
                children.start(theirs_in, theirs_out, theirs_err)
            except BaseException:
                self._close_pipes()
                raise
        self._poll = select.poll()
        for descriptor in (self._stdout, self._stderr, children.control):
            if descriptor >= 0:
                self._poll.register(descriptor, select.POLLIN)
        for descriptor in (self._stdin, self._stdout, self._stderr):
            if descriptor >= 0:
                os.set_blocking(descriptor, False)

    @property
    def has_more(self) -> bool:
        """The child wrote more than the answer, or answered before it had read the request."""
        return bool(self._received or self._waiting)

    def is_fresh(self) -> bool:
        """Returns whether the child lives and has written nothing since its last answer."""
        for descriptor, _ in self._poll.poll(0):
            if descriptor == self._stderr:
                self._read_messages()
            else:
                return False
        return self._ended is None

    def ask(self, request: bytes, seconds: float, limit: str = RUN_LIMIT) -> bytes:
        """Sends a line and returns the line of the answer. After an error, `stop` must follow. `limit`: origin of the time limit."""
        self._limit = limit
        self._waiting = memoryview(request)
        self._write()
        deadline = time.monotonic() + seconds
        searched = 0
        while True:
            self._step(deadline, seconds)
            end = self._received.find(b"\n", searched)
            searched = len(self._received)
            if end >= 0:
                line = bytes(self._received[:end])
                del self._received[: end + 1]
                return line
            if len(self._received) > LONGEST_LINE:
                raise NoMeasuresError(Breakdown.ERROR, f"it wrote a line of more than {LONGEST_LINE >> 20} MB")
            if self._ended is not None:
                raise self._failure(self._ended)
            if self._stdout < 0:
                deadline, seconds = min(deadline, time.monotonic() + CLOSED_SECONDS), -1.0

    def wait(self, seconds: float, limit: str = RUN_LIMIT, most: int = 0) -> bytes:
        """Waits for the child's end and returns its standard output of at most `most` bytes. After an error, `stop` must follow.

        Raises BusyError if its exit code is BUSY, and NoMeasuresError if it is another one than 0. `limit`: origin of the time limit.
        """
        self._limit = limit
        self._close_input()
        deadline = time.monotonic() + seconds
        while self._ended is None and len(self._received) <= most:
            self._step(deadline, seconds, answers=False)
        if len(self._received) > most:
            raise NoMeasuresError(Breakdown.ERROR, f"it prints more than {most:,} characters")
        if self._ended == BUSY:
            raise BusyError(self._with_tail(f"it ended with exit code {BUSY}"))
        if self._ended:
            raise self._failure(self._ended)
        return bytes(self._received)

    def tail(self) -> str:
        """Returns the last lines of standard error, printable, for an error message: control characters could steer a terminal."""
        shown = _last_lines(self._tail.decode(errors="replace"))
        return "".join(character if character.isprintable() else "?" for character in shown)

    def stop(self, farewell: bytes = b"", seconds: float = 0.0) -> None:
        """Ends the child, at once or after it had some time to end by itself after a last line. Idempotent."""
        if self._ended is None and farewell:
            with contextlib.suppress(NoMeasuresError):
                self._waiting = memoryview(farewell)
                self._write()
                self._close_input()
                deadline = time.monotonic() + seconds
                while self._ended is None:
                    self._step(deadline, seconds)
                    self._received.clear()
        if self._ended is None:
            self._ended = self._children.end()
        self._close_pipes()

    def _step(self, deadline: float, seconds: float, *, answers: bool = True) -> None:
        """Waits until something happens, and handles it. After the deadline only an answer that is there already counts: this process
        may have been stopped itself. `answers`: lines are answers."""
        left = deadline - time.monotonic()
        events = self._poll.poll(1 + 1000 * min(left, TICK_SECONDS) if left > 0 else 0)
        self._children.scan()
        control = False
        for descriptor, _ in events:
            if descriptor == self._stdout:
                self._read_output()
            elif descriptor == self._stderr:
                self._read_messages()
            elif descriptor == self._stdin:
                self._write()
            else:
                control = True
        if control:
            self._poll.unregister(self._children.control)
            self._ended = self._children.ended()
            self._drain()
        elif left <= 0 and not (answers and b"\n" in self._received):
            if seconds < 0:
                raise NoMeasuresError(Breakdown.ERROR, self._with_tail("it closed its standard output without an answer"))
            self._children.look()  # what it takes may be why it does not answer
            raise NoMeasuresError(Breakdown.HANG, self._with_tail(f"no answer after {seconds:g} s, {self._limit}"))

    def _drain(self) -> None:
        """Reads what an ended child has left in its pipes."""
        while self._stderr >= 0 and self._read_messages():
            pass
        while self._stdout >= 0 and len(self._received) <= LONGEST_LINE and self._read_output():
            pass

    def _read_output(self) -> bool:
        content = _read(self._stdout)
        if content:
            self._received += content
        elif content is not None:
            self._poll.unregister(self._stdout)
            os.close(self._stdout)
            self._stdout = -1
        return bool(content)

    def _read_messages(self) -> bool:
        content = _read(self._stderr)
        if content:
            self._tail = (self._tail + content)[-LONGEST_TAIL:]
        elif content is not None:
            self._poll.unregister(self._stderr)
            os.close(self._stderr)
            self._stderr = -1
        return bool(content)

    def _write(self) -> None:
        """Writes as much of the request as the pipe takes."""
        try:
            while self._waiting:
                self._waiting = self._waiting[os.write(self._stdin, self._waiting) :]
        except BlockingIOError:
            self._poll.register(self._stdin, select.POLLOUT)
            self._is_writing = True
            return
        except OSError:  # the child has closed its end: its messages and its end say more
            self._waiting = memoryview(b"")
        if self._is_writing:
            self._poll.unregister(self._stdin)
            self._is_writing = False

    def _close_input(self) -> None:
        if self._stdin >= 0:
            if self._is_writing:
                self._poll.unregister(self._stdin)
                self._is_writing = False
            os.close(self._stdin)
            self._stdin = -1

    def _close_pipes(self) -> None:
        for descriptor in (self._stdin, self._stdout, self._stderr):
            if descriptor >= 0:
                os.close(descriptor)
        self._stdin = self._stdout = self._stderr = -1

    def _failure(self, status: int) -> NoMeasuresError:
        """Returns the error of a child that ended without an answer."""
        cause = Breakdown.CRASH
        if 128 < status <= 128 + signal.SIGRTMAX:
            detail = f"it ended with exit code {status}, as a shell does if its program was killed by {_killer(status - 128)}"
        elif status >= 0:
            detail = f"it ended with exit code {status}"
        else:
            detail = f"it was killed by {_killer(-status)}"
        if any(text in self._tail for text in _OUT_OF_MEMORY):
            cause = Breakdown.MEMORY
        return NoMeasuresError(cause, self._with_tail(detail))

    def _with_tail(self, detail: str) -> str:
        tail = self.tail()
        return f"{detail}; its last messages: {tail}" if tail else detail


def _read(descriptor: int) -> bytes | None:
    """Reads what there is: nothing at the end, None if there is nothing yet."""
    try:
        return os.read(descriptor, _CHUNK)
    except BlockingIOError:
        return None


def _last_lines(messages: str) -> str:
    """Returns the last three lines; of a traceback of Python at the end, the last location and the last lines, without marks under code."""
    lines = [line.strip() for line in messages.splitlines() if line.strip(" \t^~")]
    places = (_PLACE.match(line) for line in lines[-LONGEST_END:-3])
    place = next((match for match in reversed(list(places)) if match is not None), None)
    if place is None or any(map(_PLACE.match, lines[-3:])):
        return " | ".join(lines[-3:])[-LONGEST_SHOWN:]
    where = f'File "{place["file"][-LONGEST_PATH:]}", line {place["line"]}'
    return f"{where} | {' | '.join(lines[-2:])[-LONGEST_SHOWN + len(where) :]}"


def _killer(number: int) -> str:
    """Returns the name of a signal, with what it means of a program that ran out of something."""
    try:
        name = signal.Signals(number).name
    except ValueError:
        name = f"signal {number}"
    if number == signal.SIGXFSZ:
        return f"{name}, because it wrote too large a file"
    if number == signal.SIGKILL:
        return f"{name}, as the system does when the machine's memory runs out"
    return name
