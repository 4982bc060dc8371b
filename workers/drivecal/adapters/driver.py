"""The side of the child in drivecal's own drivers: reads requests and writes answers on private copies of the standard streams.

A driver runs as `python -I -B -m ...`, and gets its settings, which `drivecal.adapters.kinds` writes, with the first request. What a user's
code prints goes to standard error, and its programs cannot read requests.
"""

import json
import os
import sys
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from drivecal.domain.errors import DrivecalError, UnavailableError

LONGEST_MESSAGE = 290
"""Characters of drivecal's own messages; an adapter shows 300."""
Evaluate = Callable[[Mapping[str, Any]], Mapping[str, Any]]
"""Answers a request, without its id."""


class UnusableError(DrivecalError):
    """An FMU cannot be used as problem.yaml says."""


def serve(prepare: Callable[[Mapping[str, Any]], Evaluate]) -> None:
    """Serves requests until `quit` or the end of input. `prepare` gets the settings of the first one. Its exception, or that of a run,
    becomes an error in the answer.

    A MemoryError ends the process, which may be in any state.
    """
    requests = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)

    own = os.getpid()

    def say(answer: str) -> None:
        if os.getpid() != own:
            os._exit(0)  # a copy that the user's code has forked
        answers.write(answer.encode() + b"\n")
        answers.flush()

    evaluate: Evaluate | None = None
    for line in requests:
        request = json.loads(line)
        if "quit" in request:
            break
        if evaluate is None:
            try:
                evaluate = prepare(request["settings"])
            except MemoryError:
                raise
            except (Exception, SystemExit) as error:  # noqa: BLE001  # a user's code may raise any exception
                say(json.dumps({"error": described(error), "unsuitable": blames_files(error)}))
                break
            say(json.dumps({"ready": True}))
            continue
        try:
            answer = json.dumps({**evaluate(request), "id": request["id"]})
        except MemoryError:
            raise
        except (Exception, SystemExit) as error:  # noqa: BLE001  # a user's code may raise any exception
            answer = json.dumps({"id": request["id"], "error": described(error)})
        say(answer)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # threads of a user's code and the unloading of libraries must not delay or crash the end


def blames_files(error: BaseException) -> bool:
    """Returns whether a start fails by the problem's files alone: on every machine, with everything installed."""
    if isinstance(error, DrivecalError):
        return not isinstance(error, UnavailableError)
    return isinstance(error, (SyntaxError, NameError))


def described(error: BaseException) -> str:
    """Returns type, message and location of an exception; only the message if drivecal raises it on purpose."""
    if isinstance(error, DrivecalError):
        return " | ".join(str(error).splitlines())[:LONGEST_MESSAGE]
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if Path(frame.filename).parent != Path(__file__).parent and not frame.filename.startswith("<")  # a user's, not ours
    ]
    location = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    text = "".join(traceback.format_exception_only(error)).strip()
    return (text if len(text) <= 250 else f"{text[:120]} ... {text[-120:]}") + location
