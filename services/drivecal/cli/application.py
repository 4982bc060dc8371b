"""The application, its common options, and its errors."""

import re
import sys
from enum import IntEnum
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from drivecal.client import Client
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import (
    DrivecalError,
    InvalidInputError,
    NotAuthorisedError,
    NotFoundError,
    Problem,
    UnavailableError,
)


class ExitCode(IntEnum):
    """Exit status of a command."""

    OK = 0
    FAILED = 1
    USAGE = 2
    CANCELLED = 3
    UNREACHABLE = 4
    NOT_FOUND = 5
    TIMED_OUT = 6
    INTERRUPTED = 130


ORDER = (
    *("demo", "serve", "submit", "list", "show", "watch", "pause", "resume", "cancel", "finish", "rerun", "label", "delete"),
    *("solutions", "report", "export", "explain", "influence", "influence-maps", "robustness", "validate"),
    *("compare-optimizers", "evaluate", "check", "problem", "workers", "db"),
)
"""Order of the commands in the help."""


EXTRAS = {
    **dict.fromkeys(("alembic", "fastapi", "libsumo", "numba", "prometheus_client", "psycopg", "pyarrow", "scipy"), "local"),
    **dict.fromkeys(("sklearn", "sqlalchemy", "starlette", "structlog", "uvicorn", "websockets"), "local"),
    "ray": "cluster",
}
"""Extra of drivecal that installs a package, by the package's module."""

SECONDS_TO_COMPLETE = 2.0
"""Longest time that a shell waits for the ids of campaigns."""

_COMMANDS = (
    (r"\bGET /api/v1/influence-maps\b(?!/)", "`drivecal influence-maps list`"),
    (r"\bGET /api/v1/campaigns\b(?!/)", "`drivecal list`"),
    (r"\bGET /api/v1/evaluations/(\w+)", r"`drivecal show \1`"),
    (r"\bPOST /api/v1/comparisons\b(?!/)", "`drivecal compare-optimizers`"),
    (r"\bpost another one to /api/v1/evaluations\b", "make another one with `drivecal evaluate`"),
)
"""Commands for the server's hints."""

_LISTS = {
    "campaign": "`drivecal list` prints those that exist",
    "influence map": "`drivecal influence-maps list` prints those that exist",
    "campaign or influence map": "`drivecal list` and `drivecal influence-maps list` print those that exist",
    "comparison": "`drivecal list` prints the tags of campaigns",
    "problem": "`drivecal problem list` prints those that exist",
    "evaluation": "`drivecal export ID` prints those of a campaign, in its column id",
}
"""Commands that list the objects of a kind."""


class Commands(TyperGroup):
    """A group whose commands report drivecal's errors on stderr, one line per problem, and exit with the fitting code."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Returns the commands in the order of `ORDER`."""
        return sorted(super().list_commands(ctx), key=lambda name: ORDER.index(name) if name in ORDER else len(ORDER))

    def invoke(self, ctx: Any) -> Any:
        """Runs the command."""
        try:
            return super().invoke(ctx)
        except DrivecalError as error:
            complain(error)
            raise typer.Exit(exit_code(error)) from error
        except ModuleNotFoundError as error:
            missing = (error.name or "").partition(".")[0]
            if missing not in EXTRAS:
                raise
            tell(f"this needs {missing}, which is not installed; type: pip install 'drivecal[{EXTRAS[missing]}]'")
            raise typer.Exit(ExitCode.USAGE) from error
        except KeyboardInterrupt as error:
            tell("interrupted")
            raise typer.Exit(ExitCode.INTERRUPTED) from error


app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Calibrates the parameters of automated driving functions in simulation and simulates only what can change the answer.",
)

JsonOption = Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")]
UrlOption = Annotated[
    str | None, typer.Option("--url", help="The server; else DRIVECAL_URL, else the config file, else http://127.0.0.1:8000.")
]


def campaign_ids(incomplete: str) -> list[str]:
    """Returns the ids of the newest campaigns that begin so, for the completion of a shell; none if no server answers."""
    try:
        with Client(timeout=SECONDS_TO_COMPLETE) as client:
            return [campaign.id for campaign in client.campaigns(limit=200).items if campaign.id.startswith(incomplete)]
    except DrivecalError:
        return []


CampaignArgument = Annotated[
    str,
    typer.Argument(metavar="ID", help="The campaign's id, or at least its first four characters.", autocompletion=campaign_ids),
]


class WaitTimedOutError(DrivecalError):
    """The user's waiting time is over. The campaign continues."""


def exit_code(error: DrivecalError) -> ExitCode:
    """Returns the exit status of an error."""
    codes = {
        InvalidInputError: ExitCode.USAGE,
        NotFoundError: ExitCode.NOT_FOUND,
        UnavailableError: ExitCode.UNREACHABLE,
        NotAuthorisedError: ExitCode.UNREACHABLE,
        WaitTimedOutError: ExitCode.TIMED_OUT,
    }
    return next((code for kind, code in codes.items() if isinstance(error, kind)), ExitCode.FAILED)


def code_of_state(state: str) -> ExitCode:
    """Returns the exit status of a command that waited for the end of a campaign."""
    codes = {CampaignState.CANCELLED: ExitCode.CANCELLED, CampaignState.FAILED: ExitCode.FAILED}
    return codes.get(CampaignState(state), ExitCode.OK)


def complain(error: DrivecalError) -> None:
    """Prints an error to stderr, one line per problem. Fields with the same problem share a line."""
    text = str(error)
    if isinstance(error, InvalidInputError):
        fields: dict[tuple[str, str], list[str]] = {}
        for problem in error.problems:
            fields.setdefault((problem.message, problem.remedy), []).append(problem.field)
        text = "\n".join(str(Problem(", ".join(dict.fromkeys(names)), *said)) for said, names in fields.items())
    if isinstance(error, NotFoundError) and not error.hint and error.kind in _LISTS:
        text = f"{text}; {_LISTS[error.kind]}"
    for call, command in _COMMANDS:
        text = re.sub(call, command, text)
    for line in text.splitlines():
        typer.echo(f"drivecal: {line}", err=True)


def tell(message: str) -> None:
    """Prints to stderr."""
    typer.echo(f"drivecal: {message}", err=True)
    sys.stderr.flush()


def connect(url: str | None) -> Client:
    """Returns a client of the server at `url`, by default that of the environment or the config file."""
    return Client(url)
