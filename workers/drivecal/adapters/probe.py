"""Runs the `probe` of a bundle: a command whose output is the version of tools outside of the bundle, in a child as its simulator's."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivecal.adapters.children import Children, Launch, check_command
from drivecal.adapters.pipes import Pipes
from drivecal.adapters.scratch import Scratch
from drivecal.domain.errors import UnavailableError
from drivecal.plugins.simulators import PROBE_SECONDS, NoMeasuresError

LONGEST_ANSWER = 4000
"""Largest answer in characters."""


def run_probe(section: Mapping[str, Any], folder: Path) -> str:
    """Returns what the probe of a manifest's section `simulator` prints; what it prints as messages if that is nothing.

    `folder`: the unpacked bundle. Raises UnavailableError if it cannot be run, fails, or prints nothing or too much.
    """
    command = section["probe"]
    scratch = Scratch(folder)
    children = Children(Launch.of(command, section), scratch)
    try:
        check_command(command, scratch.work)
        return _answer(children)
    except (UnavailableError, NoMeasuresError) as error:
        message = f"the probe `{' '.join(command)}` gives no answer: {scratch.shown(str(error))}"
        raise UnavailableError(message) from None
    finally:
        children.close()
        scratch.remove()


def _answer(children: Children) -> str:
    pipes = Pipes(children)
    try:
        output = pipes.collect(PROBE_SECONDS, LONGEST_ANSWER, "the limit of a probe")
        answer = "\n".join(line.rstrip() for line in output.decode(errors="replace").strip().splitlines()) or pipes.tail()
    finally:
        pipes.stop()
    if not answer:
        raise UnavailableError("it prints nothing")
    return answer
