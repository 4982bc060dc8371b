"""Writes the pages of the reference from the code: commands, campaign files, problems, tables, REST, Python, settings, the motorway.

python docs/reference.py     # writes docs/pages/reference; a test compares
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import textwrap
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import typer
from pydantic import BaseModel

from drivecal import client
from drivecal.api.app import create_app
from drivecal.bundles import highway, manifest, shapes
from drivecal.bundles.installed import installed_problems
from drivecal.cli.__main__ import app
from drivecal.configuration.settings import PREFIX, Settings
from drivecal.contracts import comparison, specification, tables
from drivecal.domain.vehicles import CLOSED_LOOP_MEASURES
from drivecal.highway.planner.plugin import RANGES

TARGET = Path(__file__).parent / "pages" / "reference"
MADE = "<!-- Made by docs/reference.py from the code: `make docs`. -->\n\n"
CAMPAIGN = (
    specification.CampaignSpecification,
    specification.ParameterSpecification,
    specification.VehicleSpecification,
    specification.OptimizerSection,
    specification.OptimizerSpecification,
    specification.BudgetSpecification,
    specification.VariantSpecification,
    specification.ObjectiveSpecification,
    specification.ConstraintSpecification,
    specification.ReplicatesSpecification,
    specification.ReductionSpecification,
    specification.SensitivitySpecification,
    specification.RobustnessSpecification,
    specification.ValidationSpecification,
)
OTHER_FILES = (comparison.ComparisonSpecification, specification.RerunSpecification, specification.InfluenceMapSpecification)
PROBLEM = (
    manifest.Manifest,
    specification.ParameterEntry,
    shapes.ShapeEntry,
    shapes.CurveAxis,
    shapes.MapAxes,
    manifest.VariedEntry,
    manifest.ScoreEntry,
    manifest.PythonSimulator,
    manifest.ProcessSimulator,
    manifest.CommandSimulator,
    manifest.FmuSimulator,
    highway.HighwaySimulator,
    highway.FmuController,
    highway.PlannerController,
    highway.TaskScenario,
    highway.Task,
    highway.HighwayScenario,
    highway.OpenScenario,
)
ROWS: Mapping[str, type[BaseModel]] = {
    "evaluations": tables.EvaluationRow,
    "generations": tables.Generation,
    "solutions": tables.Solution,
    "front": tables.FrontRow,
    "influence": tables.InfluenceRow,
    "robustness": tables.RobustnessRow,
    "validation": tables.ValidationRow,
}
"""Rows by the name of their table."""
ROWS_TEXT = """\
# Tables

Rows of a campaign's tables, as `drivecal export ID --table NAME`, `client.frame(ID, NAME)` and `GET /campaigns/ID/NAME` give them. In
files, and in `where`, a parameter is a column of its name (`parameter_NAME` if another column has that name), a score `score_SCENARIO`, a
bounded value `constraint_NAME`, an objective `objective_NAME`, with `--measures` a measure `measure_NAME`. Fronts also have
`value_NAME@SCENARIO` and `answer_SCENARIO`.

"""
SETTINGS_TEXT = """\
# Settings

Flags override `DRIVECAL_*` environment variables, and these override `drivecal.toml` in the working directory or `config.toml` in the home
folder. A file names a setting like its variable, without `DRIVECAL_` and in small letters: `workers = 2`. Settings of the
cluster are in `.env.example`.

TABLE

`DRIVECAL_BUNDLE_CACHE` (default `~/.cache/drivecal/bundles`, else a temporary folder) is a folder of each worker's machine: unpacked
problems by digest. It belongs to the worker's user, mode 0700; others are refused. Problems that
were not used for 30 days are removed; workers get them again.

`DRIVECAL_SIMULATOR_FOLDERS` (a variable of each worker's machine; default none) names folders, separated by colons, that simulators may
change besides their own; `/` means no confinement. See [Security](../concepts/security.md).
"""
MOTORWAY_TEXT = """\
# The built-in motorway

The planner takes the candidate of lowest cost. Each parameter weighs a term of the cost (a mean over the planned seconds), so only their
proportions matter. The ranges come from the paper's Table 6; the meanings are ours.

PARAMETERS

## Scenarios

SCENARIOS

The built-in problem `highway-random` has the same scenarios with random traffic, S1r to S6r ([random simulators](../how-to/random.md)).

## Measures

Objectives and constraints can name them.

MEASURES

## Score

The score rates comfort from 0 to 7. A collision, leaving the road, an unstable vehicle and a missed task score 0. The evaluator `reference`
rates peaks, jerk and offsets; `learned`
rates the time series ([card](../../../workers/drivecal/highway/comfort/learned.md)). The vehicle is
`single_track` or `hybrid` ([card](../../../workers/drivecal/highway/vehicle/hybrid.md)).
"""
LARGE = 2**62
"""A larger limit only states the range of the data type: the reference omits it."""
METHODS = ("get", "post", "put", "patch", "delete")
Schema = Mapping[str, Any]


def cell(text: str) -> str:
    """Returns a text that fits into a cell of a table."""
    return " ".join(text.replace("|", "\\|").replace("<", "&lt;").split())


def table(header: Sequence[str], rows: Iterator[Sequence[str]] | Sequence[Sequence[str]]) -> str:
    """Returns a Markdown table, or nothing without rows."""
    lines = ["| " + " | ".join(cell(text) for text in row) + " |" for row in rows]
    return "\n".join([f"| {' | '.join(header)} |", "|" + "---|" * len(header), *lines]) + "\n" if lines else ""


def code(text: object) -> str:
    """Returns a text as code, or nothing."""
    return f"`{text}`" if str(text) else ""


def prose(docstring: str | None) -> str:
    """Returns a docstring as paragraphs, its own line breaks removed."""
    return "\n\n".join(" ".join(named(part).split()) for part in inspect.cleandoc(docstring or "").split("\n\n"))


def named(paragraph: str) -> str:
    """Returns a paragraph, one of arguments or attributes without its heading and with their names as code."""
    heading, _, rest = paragraph.partition("\n")
    if heading not in {"Args:", "Attributes:", "Raises:"}:
        return paragraph
    entries = re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", rest, re.MULTILINE)
    return f"{'Raises ' * (heading == 'Raises:')}" + " ".join(f"`{name}`: {text}" for name, text in entries)


def field_notes(model: type) -> dict[str, str]:
    """Returns the docstrings below the fields of a class and its bases."""
    notes: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if base.__module__.startswith("drivecal"):
            body = typing.cast("ast.ClassDef", ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]).body
            for statement, following in pairwise(body):
                name = getattr(getattr(statement, "target", None), "id", None)
                note = getattr(getattr(following, "value", None), "value", None)
                if isinstance(statement, ast.AnnAssign) and isinstance(following, ast.Expr) and isinstance(note, str):
                    notes[str(name)] = prose(note)
    return notes


def kind(schema: Schema) -> str:
    """Returns the type of a JSON schema and its limits in words."""
    if "$ref" in schema:
        return str(schema["$ref"]).rpartition("/")[2]
    if "const" in schema:
        return str(schema["const"])
    if "enum" in schema:
        return ", ".join(map(str, schema["enum"]))
    alternatives = schema.get("anyOf") or schema.get("oneOf")
    if alternatives:
        return " or ".join(dict.fromkeys(kind(alternative) for alternative in alternatives))
    if schema.get("type") == "array":
        return "list" + (f" of {kind(schema['items'])}" if schema.get("items") else "")
    if schema.get("type") == "object":
        values = schema.get("additionalProperties")
        return "mapping" + (f" to {kind(values)}" if isinstance(values, dict) and values else "")
    words = {"string": "text", "boolean": "true or false", "number": "number", "integer": "integer", "null": "null"}
    return words.get(str(schema.get("type")), "any value") + limits(schema)


def limits(schema: Schema) -> str:
    """Returns the limits of a number in words, or nothing."""
    lower, above = schema.get("minimum"), schema.get("exclusiveMinimum")
    upper, below = schema.get("maximum"), schema.get("exclusiveMaximum")
    if lower is not None and upper is not None and upper < LARGE:
        return f", {number(lower)} to {number(upper)}"
    bounds = [
        f"{word} {number(bound)}"
        for word, bound in (("at least", lower), ("above", above), ("at most", upper), ("below", below))
        if bound is not None and abs(bound) < LARGE
    ]
    return "".join(f", {bound}" for bound in bounds)


def number(value: float) -> str:
    """Returns a number without a needless fraction."""
    return f"{int(value):,}" if value == int(value) else f"{value:g}"


def default_of(schema: Schema, name: str, required: Sequence[str]) -> str:
    """Returns the default of a field, as in a file."""
    if name in required:
        return "required"
    value = schema.get("default")
    if isinstance(value, dict) and value:
        return "its own defaults"
    return code(value if isinstance(value, str) and not value.isdecimal() else json.dumps(value))


def fields(model: type[BaseModel], heading: str, title: str = "") -> str:
    """Returns a section with the fields of a model, headed by its name without a `title`."""
    schema, notes = model.model_json_schema(), field_notes(model)
    required = schema.get("required", [])
    rows = [
        (code(name), kind(field), default_of(field, name, required), notes.get(name, ""))
        for name, field in schema.get("properties", {}).items()
    ]
    return f"{heading} {title or model.__name__}\n\n{prose(model.__doc__)}\n\n{table(('field', 'value', 'default', 'meaning'), rows)}\n"


def command_line() -> str:
    """Returns the page of all commands."""
    parts = [
        "# Commands\n\nEvery command takes `--help`, most `--json`. [The command line](../how-to/command-line.md) has examples.\n"
    ]
    parts += commands(typer.main.get_command(app), "drivecal")
    return "\n".join(parts)


def commands(command: Any, name: str) -> Iterator[str]:
    """Yields a section for a command, or for each command of a group."""
    if hasattr(command, "commands"):
        listed = command.list_commands(None)
        for inner in listed:
            yield from commands(command.get_command(None, inner), f"{name} {inner}")
        return
    arguments = [parameter for parameter in command.params if parameter.param_type_name == "argument"]
    options = [
        parameter
        for parameter in command.params
        if parameter.param_type_name == "option" and not parameter.hidden and parameter.name != "help"
    ]
    usage = " ".join([name, *map(placeholder, arguments), *(["[OPTIONS]"] if options else [])])
    rows = [(code(placeholder(parameter)), parameter.help or "") for parameter in arguments]
    rows += [(code(", ".join([*option.opts, *option.secondary_opts])), option_help(option)) for option in options]
    yield f"## {name}\n\n{prose(command.help)}\n\n```text\n{usage}\n```\n\n{table(('argument or option', 'meaning'), rows)}"


def placeholder(argument: Any) -> str:
    """Returns an argument as the usage line shows it."""
    shown = (argument.metavar or argument.name).upper() + ("..." if argument.nargs != 1 else "")
    return shown if argument.required else f"[{shown}]"


def option_help(option: Any) -> str:
    """Returns the help of an option with its default."""
    default = option.default
    shown = default is not None and not callable(default) and default not in (False, (), [], "")
    return (option.help or "") + (f" Default: {getattr(default, 'value', default)}." if shown else "")


def campaign_file() -> str:
    """Returns the page of campaign files: the commented example, then all fields with their limits."""
    return (
        "# Campaign files\n\nYAML or JSON; a REST body has the same fields. Everything has a default, and `{}` is a campaign as well.\n\n"
        + shown_file("deploy/examples/highway.yaml")
        + "\n".join(fields(model, "##") for model in CAMPAIGN)
        + "\n# Other files\n\n"
        + "\n".join(fields(model, "##") for model in OTHER_FILES)
    )


def shown_file(name: str) -> str:
    """Returns a YAML file of the project as a block."""
    return f'```yaml title="{name}"\n{(TARGET.parents[2] / name).read_text()}```\n\n'


def problem_file() -> str:
    """Returns the page of problem.yaml."""
    return (
        "# problem.yaml\n\n[What a problem is](../how-to/problems.md) explains it by examples.\n\n"
        + shown_file("deploy/examples/problems/python-function/problem.yaml")
        + "\n".join(fields(model, "##") for model in PROBLEM)
    )


def table_columns() -> str:
    """Returns the page of the rows of all tables."""
    return ROWS_TEXT + "\n".join(fields(model, "##", name) for name, model in ROWS.items())


def rest() -> str:
    """Returns the page of all routes, from the OpenAPI document."""
    with TemporaryDirectory() as folder:
        document = create_app(Settings(database_url=f"sqlite:///{folder}/unused.db")).openapi()
    sections: dict[str, list[tuple[str, str, str]]] = {}
    for path, methods in document["paths"].items():
        for method, route in methods.items():
            if method in METHODS:
                query = [parameter["name"] for parameter in route.get("parameters", []) if parameter["in"] == "query"]
                sections.setdefault(route["tags"][0], []).append(
                    (code(f"{method.upper()} {path}"), route.get("description", ""), ", ".join(map(code, query)))
                )
    parts = [f"## {tag.capitalize()}\n\n{table(('route', 'does', 'query'), rows)}" for tag, rows in sections.items()]
    return (
        "# REST\n\nSchemas of bodies and answers: `/docs` and `/openapi.json` of a server. [Examples](../how-to/rest.md).\n\n"
        + "\n".join(parts)
    )


def python() -> str:
    """Returns the page of the client's methods."""
    parts = ["# Python\n\n[Examples](../how-to/python.md). Answers are pydantic models with the fields of the REST API.\n"]
    for public in (client.Client, client.DownloadedTable):
        parts.append(f"## {public.__name__}\n\n{prose(public.__doc__)}\n")
        inherited = (vars(owner) for owner in reversed(public.__mro__) if owner.__module__.startswith(client.__name__))
        declared = {name: member for owner in inherited for name, member in owner.items()}
        members = [
            (name, member)
            for name, member in (vars(public) | declared).items()
            if isinstance(member, types.FunctionType) and (not name.startswith("_") or name == "__init__") and member.__doc__
        ]
        parts.append(
            table(("call", "does"), [(code(signature(name, member)), prose(member.__doc__)) for name, member in members])
        )
    return "\n".join(parts)


def signature(name: str, method: types.FunctionType) -> str:
    """Returns a call with the names of its arguments and their defaults."""
    arguments = [
        re.sub(r":.*?(?= = |$)", "", str(argument)).replace(" = ", "=")
        for argument in list(inspect.signature(method).parameters.values())[1:]
    ]
    return f"{'Client' if name == '__init__' else name}({', '.join(arguments)})"


def settings() -> str:
    """Returns the page of all settings."""
    schema, notes = Settings.model_json_schema()["properties"], field_notes(Settings)
    rows = [
        (
            code(PREFIX + name.upper()),
            code(field["default"]) if field.get("default") not in (None, "") else "",
            kind(field),
            notes.get(name, ""),
        )
        for name, field in schema.items()
    ]
    return SETTINGS_TEXT.replace("TABLE", table(("variable", "default", "value", "meaning"), rows))


def motorway() -> str:
    """Returns the page of the built-in problem."""
    parameters = [
        (name, f"{low} to {high}{' dB' if unit == 'dB' else ''} in steps of {step}", text)
        for name, low, high, step, _, unit, text in RANGES
    ]
    scenarios = [(name, data["title"]) for name, data in installed_problems()["highway"].manifest.scenarios.items()]
    texts = {
        "PARAMETERS": table(("parameter", "range", "meaning"), parameters),
        "SCENARIOS": table(("id", "scenario"), scenarios),
        "MEASURES": table(("measure", "unit"), [(code(name), unit) for name, unit in CLOSED_LOOP_MEASURES.items()]),
    }
    return re.sub("|".join(texts), lambda match: texts[match[0]], MOTORWAY_TEXT)


PAGES = {
    "cli.md": command_line,
    "campaign.md": campaign_file,
    "problem.md": problem_file,
    "tables.md": table_columns,
    "rest.md": rest,
    "python.md": python,
    "settings.md": settings,
    "motorway.md": motorway,
}


def pages() -> dict[str, str]:
    """Returns the text of each page by its file name."""
    return {name: MADE + re.sub(r"\n{3,}", "\n\n", make()).strip() + "\n" for name, make in PAGES.items()}


if __name__ == "__main__":
    for name, text in pages().items():
        (TARGET / name).write_text(text, encoding="utf-8")
