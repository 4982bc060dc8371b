"""The application, its common options, and its errors."""

import errno
import sys
from enum import IntEnum
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import (
    DrivecalError,
    InvalidInputError,
    NotAuthorisedError,
    NotFoundError,
    Problem,
    UnavailableError,
)

if TYPE_CHECKING:
    from drivecal.client import Client


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


COMMANDS: dict[str, tuple[str, str]] = {
    "demo": ("demo", "Calibrate the motorway planner in six SUMO scenarios on this machine, then again with other weights."),
    "serve": ("serve", "Run the server: the API and the dispatcher with its workers."),
    "submit": ("campaigns", "Submit a campaign."),
    "list": ("campaigns", "List campaigns, newest first."),
    "show": ("campaigns", "Show one campaign, or a single evaluation by its whole id."),
    "watch": ("campaigns", "Follow a campaign until it has ended."),
    "pause": ("campaigns", "Pause a campaign; running simulations are finished and kept."),
    "resume": ("campaigns", "Resume a paused campaign."),
    "cancel": ("campaigns", "End a campaign; finished simulations are kept."),
    "finish": ("campaigns", "End a campaign that another program feeds, as soon as the sets that it has are answered."),
    "rerun": ("campaigns", "Run an ended campaign again with other weights or another evaluator, on the stored results."),
    "label": ("campaigns", "Change a campaign's name or tags."),
    "delete": ("campaigns", "Delete an ended campaign to which no other refers."),
    "solutions": ("results", "Show the best parameter sets of a campaign."),
    "importance": ("results", "Show what matters: how much the objective depends on each parameter."),
    "front": ("results", "Show the sets of a campaign that no other set beats in every objective."),
    "report": ("results", "Write a campaign's results as one page that needs no server, its tables and its specification."),
    "export": ("results", "Write a whole table of a campaign to a file, or its best set as a calibration file."),
    "explain": ("evaluate", "Explain why a cell was answered without a simulation, or why it was not."),
    "influence": ("influence", "Show where each parameter can change the score of each scenario."),
    "influence-maps": ("influence", "Influence maps: where a parameter can change the score of a scenario, and where not."),
    "robustness": ("studies", "Rank the best sets of a campaign by how far the vehicle may differ."),
    "validate": ("studies", "Check by simulation whether a campaign's influence map is right."),
    "compare-optimizers": (
        "compare_optimizers",
        "Calibrate one problem with several optimizers, populations, seeds and reductions, and compare the results.",
    ),
    "evaluate": ("evaluate", "Simulate one parameter set and show its scores."),
    "check": ("check", "Check whether a set keeps its limits in every scenario; exit status 1 if not."),
    "parameters": ("problem", "Print the parameters of calibration files as sections of problem.yaml."),
    "problem": ("problem", "Your own problems: a simulation, its parameters, measures and scores."),
    "results": ("imported", "Results of vehicles, test benches and other tools, compared with simulations."),
    "workers": (
        "serve",
        "Show the workers with their activity and speed, and their share of busy time in the last 15 minutes.",
    ),
    "db": ("db", "The database. These commands open it themselves and need no server."),
}
"""Module below `cli.commands` and summary of each command, in the order of the help: a command imports its own module only."""


EXTRAS = {
    **dict.fromkeys(("alembic", "fastapi", "libsumo", "numba", "prometheus_client", "psycopg", "pyarrow", "scipy"), "local"),
    **dict.fromkeys(("sklearn", "sqlalchemy", "starlette", "structlog", "uvicorn"), "local"),
    "ray": "cluster",
}
"""Extra of drivecal that installs a package, by the package's module."""

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

    _summarises = False

    def list_commands(self, *_: Any) -> list[str]:
        """Returns the commands in the order of `COMMANDS`."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Returns a command, whose module is imported unless the help only summarises it."""
        if cmd_name in COMMANDS and cmd_name not in self.commands:
            module, summary = COMMANDS[cmd_name]
            if self._summarises:
                return TyperCommand(cmd_name, help=summary)
            import_module(f"drivecal.cli.commands.{module}")
            self.commands.update(typer.main.get_group(app).commands)
        return super().get_command(ctx, cmd_name)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Writes the help."""
        self._summarises = True
        super().format_help(ctx, formatter)

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
            say(f"this needs {missing}, which is not installed; type: pip install 'drivecal[{EXTRAS[missing]}]'")
            raise typer.Exit(ExitCode.USAGE) from error
        except OSError as error:  # mostly of the output, on a full disk
            if error.errno == errno.EPIPE:
                raise
            say(str(error))
            raise typer.Exit(ExitCode.FAILED) from error
        except KeyboardInterrupt as error:
            say("interrupted")
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

CampaignArgument = Annotated[str, typer.Argument(metavar="ID", help="The id, or at least its first four characters.")]


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
    for line in text.splitlines():
        typer.echo(f"drivecal: {line}", err=True)


def say(message: str) -> None:
    """Prints to stderr."""
    typer.echo(f"drivecal: {message}", err=True)
    sys.stderr.flush()


def connect(url: str | None) -> "Client":
    """Returns a client of the server at `url`, by default that of the environment or the config file."""
    from drivecal.client import Client  # it takes most of the start, which the help does not need

    return Client(url)
