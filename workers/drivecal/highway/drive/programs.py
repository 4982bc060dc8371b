"""Controllers that are programs: started once, they answer a frame of commands for each frame of signals, over pipes."""

import json
import os
import struct
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from drivecal.domain.errors import DrivecalError
from drivecal.highway.drive.observation import FRAMED, NAMES

LONGEST_LINE = 1 << 16
"""Largest answer in bytes."""
END_SECONDS = 1.0
"""Time for a program that has closed its output to end."""


class ProgramError(DrivecalError):
    """The program ended, or its answer is not a frame."""


class ProgramController:
    """A program behind pipes. A fault ends it; the next run starts another. It gets no time limit of its own: the run has one.

    Greeting and begin of each run are lines of JSON, which the program answers by `{"ready": true}`. In JSON frames, signals and commands
    are objects of a line. In binary frames, they are doubles in the machine's byte order, in the order of the greeting, and a frame of NaN
    announces the line of the next run.
    """

    def __init__(
        self,
        section: Mapping[str, Any],
        work: Path,
        scenario: Mapping[str, Any],
        period: float,
        names: Sequence[str] = NAMES,
        role: str = "controller",
    ) -> None:
        """`names`: of the signals; `role`: what the program is, for messages."""
        self._role = role
        self._command, self._work, self._scenario, self._period = section["command"], work, scenario, period
        self._output = list(section["output"])
        self._is_binary = section.get("frames") == "binary"
        self._signals = list(section.get("signals") or (names[:FRAMED] if self._is_binary else names))
        self._indices = [list(names).index(name) for name in self._signals]
        self._frame = struct.Struct(f"={len(self._signals)}d")
        self._points = section.get("points")
        self._answer = struct.Struct(f"={len(self._output) if self._points is None else 3 * self._points}d")
        self._process: subprocess.Popen[bytes] | None = None
        self._received = b""
        self._number = 0
        self._stdin = self._stdout = -1

    def begin(self, parameters: Mapping[str, Any], **start: float) -> None:
        """Tells the program of a run, with values of its start, and waits until it is ready. Raises ProgramError."""
        self._number += 1
        try:
            if self._process is None:
                self._start()
            elif self._is_binary:
                self._send(self._frame.pack(*[float("nan")] * len(self._signals)))
            self._ask({"run": self._number, "parameters": dict(parameters), "scenario": dict(self._scenario)} | start)
        except BaseException:
            self._stop()
            raise

    def step(self, signals: Sequence[float]) -> Sequence[Any]:
        """Returns the program's commands, unchecked. Raises ProgramError."""
        try:
            chosen = [signals[index] for index in self._indices]
            if self._is_binary:
                self._send(self._frame.pack(*chosen))
                values = self._answer.unpack(self._read(self._answer.size))
                return values if self._points is None else [[values[row : row + 3] for row in range(0, len(values), 3)]]
            self._send(json.dumps(dict(zip(self._signals, chosen, strict=True))).encode() + b"\n")
            answer = self._line()
            if len(self._output) == 1 and isinstance(answer, (int, float)):
                return (answer,)
            if not isinstance(answer, dict) or answer.keys() != set(self._output):
                raise ProgramError(f"the {self._role} answered {answer!r:.200}, not an object of {', '.join(self._output)}")
            return [answer[name] for name in self._output]
        except BaseException:
            self._stop()
            raise

    def _start(self) -> None:
        try:
            self._process = subprocess.Popen(  # noqa: S603  # the user's program, limited like this process
                self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=self._work, bufsize=0
            )
        except OSError as error:
            raise ProgramError(f"{self._command[0]} cannot be started: {error}") from error
        assert self._process.stdin is not None  # noqa: S101  # for the type checker
        assert self._process.stdout is not None  # noqa: S101  # for the type checker
        self._stdin, self._stdout, self._received = self._process.stdin.fileno(), self._process.stdout.fileno(), b""
        greeting = {"drivecal": 1, "signals": self._signals, "output": self._output, "period": self._period}
        self._ask(greeting | {"frames": "binary" if self._is_binary else "json"})

    def _ask(self, message: Mapping[str, Any]) -> None:
        self._send(json.dumps(message, allow_nan=False).encode() + b"\n")
        answer = self._line()
        if not isinstance(answer, dict) or answer.get("ready") is not True:
            raise ProgramError(f'the {self._role} answered {answer!r:.200} to {next(iter(message))}, not {{"ready": true}}')

    def _send(self, content: bytes) -> None:
        try:
            while content:
                content = content[os.write(self._stdin, content) :]
        except OSError:
            raise self._ended() from None

    def _read(self, size: int) -> bytes:
        received = self._received
        while len(received) < size:
            more = os.read(self._stdout, 65536)
            if not more:
                raise self._ended()
            received += more
        if len(received) > size:
            raise ProgramError(f"the {self._role} wrote more than one frame in answer to one")
        self._received = b""
        return received

    def _line(self) -> Any:
        received = self._received
        while b"\n" not in received:
            more = os.read(self._stdout, 65536)
            if not more:
                raise self._ended()
            received += more
            if len(received) > LONGEST_LINE:
                raise ProgramError(f"the {self._role} wrote a line of more than {LONGEST_LINE >> 10} kB")
        line, _, rest = received.partition(b"\n")
        if rest:
            raise ProgramError(f"the {self._role} wrote more than one line in answer to one")
        self._received = b""
        try:
            return json.loads(line)
        except (ValueError, RecursionError):
            raise ProgramError(f"the {self._role}'s answer is not JSON: {line[:200].decode(errors='replace')!r}") from None

    def _ended(self) -> ProgramError:
        """Returns the error of a program that has closed its pipes; its messages are on standard error."""
        try:
            status = None if self._process is None else self._process.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            return ProgramError(f"the {self._role} closed its standard input or output")
        killed = status is not None and status < 0
        return ProgramError(
            f"the {self._role} {'was killed by signal' if killed else 'ended with exit code'} {abs(status or 0)}"
        )

    def _stop(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    pipe.close()
