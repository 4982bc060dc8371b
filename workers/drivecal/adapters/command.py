"""Simulator kind `command`: a program that is started for each run, as Dakota does: parameters file in, results file out, exit code.

The `probe` of a bundle is such a command as well: its output is the version of tools outside of the bundle.
"""

import errno
import json
import os
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from drivecal.adapters import answers
from drivecal.adapters.children import Children, check_command
from drivecal.adapters.environment import DRIVER, Scratch
from drivecal.adapters.pipes import LONGEST_LINE, Pipes
from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.domain.setups import digest
from drivecal.domain.values import Argument
from drivecal.plugins.simulators import PROBE_SECONDS, SEED, Declared, NoMeasuresError, RunOutcome

LONGEST_ANSWER, MOST_DIGESTS = 4000, 40_000
"""Largest answer of a probe, and of all digests, in characters."""
LEAST_MEMORY_MB = 500
"""Memory of the child that makes digests."""


def run_probe(section: Mapping[str, Any], folder: Path) -> str:
    """Returns what this machine reports for a manifest's section `simulator`: the probe's output, and digests of variables and inputs, a
    line each.

    `folder`: the unpacked bundle. Raises UnavailableError if a command cannot be run, fails, or prints nothing or too much.
    """
    probe, given = section.get("probe"), section.get("inputs") or ()
    lines = [] if probe is None else [_printed(probe, f"the probe `{' '.join(probe)}`", section, folder)]
    paths = [each for each in given if isinstance(each, str)]
    if section.get("environment") or paths:
        settings = json.dumps({"environment": section.get("environment") or [], "paths": paths})
        command, room = [*DRIVER, "drivecal.adapters.inputs", settings], {**section, "memory_mb": LEAST_MEMORY_MB}
        lines.append(_printed(command, "the digest of variables and inputs", room, folder, MOST_DIGESTS))
    for each in given:
        if not isinstance(each, str):
            shown = f"`{' '.join(each)}`"
            lines.append(f"{shown}: {digest(_printed(each, f'the input {shown}', section, folder, LONGEST_LINE).encode())}")
    return "\n".join(lines)


def _printed(command: Sequence[str], name: str, section: Mapping[str, Any], folder: Path, longest: int = LONGEST_ANSWER) -> str:
    """Returns what a command prints; what it prints as messages if that is nothing."""
    scratch = Scratch(folder)
    children = Children(command, section, scratch)
    try:
        check_command(command, scratch.work)
        return _answer(children, longest)
    except (UnavailableError, NoMeasuresError) as error:
        raise UnavailableError(f"{name} gives no answer: {scratch.shown(str(error))}") from None
    finally:
        children.close()
        scratch.remove()


def _answer(children: Children, longest: int) -> str:
    pipes = Pipes(children)
    try:
        output = pipes.wait(PROBE_SECONDS, "the limit of a probe", longest)
        answer = "\n".join(line.rstrip() for line in output.decode(errors="replace").strip().splitlines()) or pipes.tail()
    finally:
        pipes.stop()
    if not answer:
        raise UnavailableError("it prints nothing")
    return answer


class CommandSession:
    """A command that runs once for each parameter set, in a folder without anything of other runs, with links to the bundle's files."""

    def __init__(self, section: Mapping[str, Any], scratch: Scratch, declared: Declared, *, data: Mapping[str, Any]) -> None:
        """Writes the scenario's file."""
        self._scratch, self._declared, self._timeout = scratch, declared, section["timeout"]
        self._files = {name: scratch.folder / f"{name}.json" for name in ("parameters", "scenario", "results")}
        self._scenario = json.dumps(data, allow_nan=False)
        command = section["command"]
        for name, path in self._files.items():
            command = [part.replace(f"{{{name}}}", str(path)) for part in command]
        self._children = Children(command, section, scratch)

    def evaluate(self, parameters: Mapping[str, Argument], *, series: bool = False, seed: int = SEED) -> RunOutcome:
        """Runs the command under a seed."""
        self._children.seed = seed
        return self._children.timed(lambda: self._evaluate(parameters, series=series))

    def close(self) -> None:
        """Removes the scratch folder; no process runs between two runs."""
        self._children.close()
        self._scratch.remove()

    def _evaluate(self, parameters: Mapping[str, Argument], *, series: bool) -> RunOutcome:
        self._scratch.clear()
        self._files["parameters"].write_text(json.dumps(dict(parameters), allow_nan=False))
        self._files["scenario"].write_text(self._scenario)
        try:
            pipes = Pipes(self._children, silent=True)
        except UnavailableError as error:
            raise NoMeasuresError(Breakdown.ERROR, str(error)) from None
        try:
            pipes.wait(self._timeout)
        finally:
            pipes.stop()
        content = _content(self._files["results"], pipes.tail())
        return answers.outcome(answers.document(content, "the results file"), self._declared, series=series)


def _content(path: Path, tail: str) -> bytes:
    """Returns the results file. A link or a pipe in its place is refused: reading could hang or reveal another file."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError as error:
        messages = f"; its last messages: {tail}" if tail else ""
        fault = "the results file is a link" if error.errno == errno.ELOOP else f"it wrote no results file: {error.strerror}"
        raise NoMeasuresError(Breakdown.ERROR, fault + messages) from None
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise NoMeasuresError(Breakdown.ERROR, "the results file is not a regular file")
    with open(descriptor, "rb") as file:  # noqa: PTH123  # a descriptor has no path
        content = file.read(LONGEST_LINE + 1)
    if len(content) > LONGEST_LINE:
        raise NoMeasuresError(Breakdown.ERROR, f"the results file has more than {LONGEST_LINE >> 20} MB")
    return content
