"""`drivecal problem`: problems of users, as folders with `problem.yaml`."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drivecal.bundles.archives import content_digest, files_of
from drivecal.bundles.fmus.bundles import fields_of_resets
from drivecal.calibration_data import files
from drivecal.calibration_data.characteristics import LARGEST_FILE
from drivecal.calibration_data.sections import Sections, axis_points, chosen_by, joined, sections_of
from drivecal.cli.application import ExitCode, JsonOption, app, say
from drivecal.cli.views.output import Asked, asking, parameters_text, print_answer, print_columns, print_json, print_page, when
from drivecal.client.client import Client
from drivecal.client.problem_templates import KINDS, write_problem
from drivecal.configuration.documents import read_document
from drivecal.configuration.problems import read_bundle_with_notes
from drivecal.contracts.inventory import ProblemAnswer
from drivecal.domain.errors import file_faults

if TYPE_CHECKING:
    from drivecal.bundles.manifest import Manifest
    from drivecal.local.problems import CheckedScenario

problems = typer.Typer(no_args_is_help=True, help="Your own problems: a simulation, its parameters, measures and scores.")
app.add_typer(problems, name="problem")

SHOWN = 12
"""Characters of a digest in a sentence."""

FolderArgument = Annotated[str, typer.Argument(metavar="DIR", help="The folder with problem.yaml.")]


@problems.command()
def init(
    kind: Annotated[str, typer.Argument(metavar="KIND", help=f"The kind of simulation: {', '.join(KINDS)}.")],
    name: Annotated[str, typer.Argument(metavar="NAME", help="The problem's name.")],
    folder: Annotated[str | None, typer.Option(metavar="DIR", help="The new folder; else one called NAME.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Write a new problem that works, to be edited."""
    files = [str(file) for file in write_problem(kind, name, folder)]
    where = folder or name
    if as_json:
        print_json({"name": name, "folder": where, "files": files})
    else:
        for file in files:
            typer.echo(file)
        say(f"edit them, then type: drivecal problem check {quote(where)}")


@problems.command()
def check(folder: FolderArgument, as_json: JsonOption = False) -> None:
    """Check a problem without a server: its files, then each scenario twice at the baseline or in the middle of the space, and at
    another set that keeps the constraints."""
    from drivecal.bundles.shapes import with_coefficients, with_points
    from drivecal.local import problems as local  # the workers' code, for this command only

    manifest, archive, notes = read_bundle_with_notes(folder)
    for note in notes:
        say(note)
    report: dict[str, Any] = {
        "name": manifest.problem,
        "digest": content_digest(archive),
        "size": len(archive),
        "files": list(files_of(archive)),
        "deterministic": manifest.simulator.deterministic,
        "notes": list(notes),
        "tools": local.ask_probe(manifest, archive),
    }
    checked: list[CheckedScenario] = []
    told: dict[str, str] = {}
    parameters, other = local.trial_set(manifest), local.other_set(manifest)
    for field, tried in (("parameters", parameters), ("other_parameters", other)):
        report[field] = tried and with_points(tried, manifest.shapes, {"kind": manifest.simulator.kind})
    say(f"a run may take {manifest.simulator.timeout:g} s (`simulator.timeout` in problem.yaml)")
    for result in local.run_problem(manifest, archive, parameters, other):
        if not as_json:
            sentence = _sentence(manifest, result)
            first = told.setdefault(sentence, result.scenario)
            say(f"{result.scenario}: {sentence if first == result.scenario else f'as {first}'}")
        checked.append(result)
    if not any(result.other for result in checked):
        report["other_parameters"] = None  # no scenario came to it
    warnings = list[str]()
    with_coefficients(manifest.baseline or {}, manifest.shapes, "baseline", notes=warnings)
    warnings += [*local.doubtful_ranges(manifest, checked), *local.cut_scores(manifest, checked)]
    report["warnings"] = [*warnings, *_doubts_elsewhere(manifest, checked), *local.undeclared(manifest, checked)]
    report["scenarios"] = [asdict(result) | {"opened": sorted(result.opened)} for result in checked]
    print_answer(report, as_json, lambda: _print_check(report, checked))
    broken = [result for result in checked if result.error or (manifest.simulator.deterministic and not result.repeats)]
    if broken:
        raise typer.Exit(ExitCode.FAILED)


@problems.command()
@asking
def push(client: Client, folder: FolderArgument) -> Asked:
    """Store a problem on the server, so that campaigns can name it. Its files are checked; `problem check` runs it as well. Replaces what
    the name means; earlier campaigns keep theirs. Takes a token of the role author, or the server's own user."""
    manifest, archive, notes = read_bundle_with_notes(folder)
    for note in notes:
        say(note)
    earlier = client.problems(name=manifest.problem, limit=1).items
    pushed = client.push_problem(archive)
    say(_change(pushed, earlier[0].digest if earlier else None, folder))
    for note in pushed.notes:
        say(f"note: {note}")
    return pushed, lambda: _print_problem(pushed)


def _change(pushed: ProblemAnswer, earlier: str | None, folder: str) -> str:
    """Returns what a push changed. `earlier`: the digest that the name meant before."""
    name, digest = pushed.name, pushed.digest[:SHOWN]
    check = f"nothing was run; to run it, type: drivecal problem check {quote(folder)}"
    if earlier is None:
        return f"{name}: digest {digest}, the first of this name; {check}"
    if earlier == pushed.digest:
        return f"{name}: digest {digest}, unchanged since the last push"
    return f"{name}: new digest {digest}, replaces {earlier[:SHOWN]}; campaigns of earlier digests keep theirs; {check}"


@problems.command("list")
@asking
def list_problems(
    client: Client,
    name: Annotated[str | None, typer.Option(help="Every push of this name, not only the last one of each.")] = None,
    limit: Annotated[int, typer.Option(min=1, max=1000, help="How many at most, last pushed first.")] = 20,
) -> Asked:
    """List the problems on the server, last pushed first."""
    page = client.problems(name=name, limit=limit)
    rows = [[row.name, when(row.created_at), _size(row.size), "yes" if row.latest else "", row.digest] for row in page.items]
    return page, lambda: print_page(page, ["name", "created", "size", "latest", "digest"], rows, limit)


@problems.command()
@asking
def show(client: Client, name: Annotated[str, typer.Argument(metavar="NAME", help="The problem's name or digest.")]) -> Asked:
    """Show a problem on the server: its parameters, scenarios, measures and scores."""
    problem = client.problem(name)
    return problem, lambda: _print_problem(problem)


def _print_problem(problem: ProblemAnswer) -> None:
    typer.echo(f"{problem.name}  {problem.digest}  ({_size(problem.size)}, {problem.simulator['kind']})")
    if problem.description:
        typer.echo(problem.description)
    print_columns(
        ["parameter", "values", "unit"], [[name, _values(entry), entry["unit"]] for name, entry in problem.parameters.items()]
    )
    if problem.varied:
        rows = [[name, f"{entry['nominal']:g}, {_values(entry)}", entry["unit"]] for name, entry in problem.varied.items()]
        print_columns(["varied", "values", "unit"], rows)
    for condition in problem.constraints:
        typer.echo(f"constraint  {condition}")
    if problem.baseline:
        typer.echo(f"baseline    {parameters_text(problem.baseline, shapes=problem.shapes)}")
    typer.echo(f"scenarios   {' '.join(problem.scenarios)}")
    typer.echo(f"measures    {', '.join(f'{name} ({unit})' for name, unit in problem.measures.items())}")
    scores = [
        [name, score["direction"], score["formula"] or f"evaluator {score['evaluator']}"]
        for name, score in problem.scores.items()
    ]
    print_columns(["score", "direction", "formula"], scores)


def _values(entry: Mapping[str, Any]) -> str:
    if entry.get("choices"):
        return " | ".join(entry["choices"])
    step = " whole numbers" if entry.get("integer") else f" in steps of {entry['step']:g}" if entry.get("step") else ""
    return f"{entry['lower']:g} to {entry['upper']:g}{step}"


def _print_check(report: Mapping[str, Any], checked: Sequence["CheckedScenario"]) -> None:
    size = f"{len(report['files'])} files, packed {_size(report['size'])}"
    typer.echo(f"{report['name']}  {report['digest']}  ({size})")
    if report["tools"] is not None:
        typer.echo(f"probe     {' '.join(report['tools'].split())}")
    for title, tried in (("tried at", report["parameters"]), ("set 2   ", report["other_parameters"])):
        if tried is not None:
            typer.echo(f"{title}  {parameters_text(tried)}")
    ran = [result for result in checked if result.error is None]
    if ran:
        scores, measures = list(ran[0].scores), sorted({name for result in ran for name in result.measures})
        rows: list[list[object]] = []
        for result in ran:
            ends = ["yes" if result.repeats else "no", f"{max(result.seconds):.3f}"]
            for number, run, end in ((1, result, ends), (2, result.other, [None, None])):
                if run is not None and run.error is None:
                    values = (run.scores[name] for name in scores), (run.measures.get(name) for name in measures)
                    rows.append([result.scenario, number, *values[0], *values[1], run.failure, *end])
        print_columns(["scenario", "set", *scores, *measures, "failure", "same bits", "wall s"], rows)
    for warning in report["warnings"]:
        typer.echo(f"warning   {warning}")
    if ran:
        typer.echo("these sets alone were tried; others may fail, or leave the range of a score")


def _doubts_elsewhere(manifest: "Manifest", checked: Sequence["CheckedScenario"]) -> list[str]:
    """Returns a warning for each scenario where the other set alone has no result or no value, or another result in a new process."""
    warnings = []
    for result in checked:
        if result.other is None:
            continue
        if result.other.error is not None:
            warnings.append(f"{result.scenario}: set 2 has no result: {result.other.error}")
        undefined = {name: why for name, why in result.other.undefined.items() if name not in result.undefined}
        warnings += [f"{result.scenario}: {name} has no value for set 2: {why}" for name, why in undefined.items()]
        if result.other.alone is False:
            cause = "; ".join(["the simulator keeps state between runs", *_doubts_of_resets(manifest)])
            warnings.append(f"{result.scenario}: set 2 gives other measures in a new process: {cause}")
        if result.other.alone_error is not None:
            warnings.append(f"{result.scenario}: set 2 has no result in a new process: {result.other.alone_error}")
    return warnings


def _doubts_of_resets(manifest: "Manifest") -> list[str]:
    """Returns what to do if an FMU keeps something of its last run, if one is reset."""
    where = " or ".join(f"`{field}`" for field in fields_of_resets(manifest))
    remedy = f"the FMU's reset may be incomplete: set `reset: false` in {where}, so that each run has a new process"
    return [remedy] if where else []


def _sentence(manifest: "Manifest", result: "CheckedScenario") -> str:
    if result.error is not None:
        return f"no result: {result.error}"
    parts = [f"{max(result.seconds):.3f} s a run, ready after {result.start_seconds:.3f} s"]
    if not result.repeats:
        remedy = "; or ".join([*_doubts_of_resets(manifest), "fix their seed, or set `random: true` if they take one"])
        parts.append(f"two runs of the same parameters gave different measures: {remedy}")
    parts += [f"{name}: {reason}" for name, reason in result.undefined.items()]
    return "; ".join(parts)


def _size(size: int) -> str:
    if size < 10_000:
        return f"{size:,} bytes"
    return f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{size / 1e3:.1f} kB"


NamesOption = Annotated[
    str | None, typer.Option("--names", metavar="MAP", help="A YAML file that binds names, e.g. a line P1: ACC_tGap_C.")
]


@app.command()
def parameters(
    sources: Annotated[
        list[str], typer.Argument(metavar="FILE...", help="A2L, DCM or CDFX files; what several say is taken from the last.")
    ],
    match: Annotated[list[str] | None, typer.Option(metavar="GLOB", help="These only, e.g. 'ACC_*'; may be repeated.")] = None,
    names: NamesOption = None,
    span: Annotated[
        float, typer.Option(min=1e-6, max=1e3, help="Half the width of a range that no file gives, as a share of the value.")
    ] = 0.5,
    with_axes: Annotated[
        bool, typer.Option("--axis-points", help="Take the points of axes as parameters, too: NAME.x, or the shared axis.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Print the parameters of calibration files as sections of problem.yaml."""
    contents = []
    for source in sources:
        with file_faults(source, "read", "give an A2L, DCM or CDFX file"), Path(source).open("rb") as stream:
            read = stream.read(LARGEST_FILE + 1)
        contents.append((source, files.read(read, source)))
    labels = files.labels_of(read_document(names)) if names is not None else {}
    fixed = {name for _, content in contents for name in content.fixed}
    known = [each for each in joined(content.characteristics for _, content in contents) if each.name not in fixed]
    offered = [*known, *axis_points(known)] if with_axes else [each for each in known if each.kind != "COM_AXIS"]
    chosen = chosen_by(offered, match or [])
    sections = sections_of(chosen, {label: name for name, label in labels.items()}, span)
    document = {"parameters": sections.parameters, "baseline": sections.baseline}
    print_answer(document, as_json, lambda: typer.echo("\n".join(_yaml(sections))))
    for noted in (each for each in chosen if each.note):
        say(f"{noted.name}: {noted.note}")
    for source, content in contents:
        if content.skipped:
            names = f"{', '.join(content.skipped[:SHOWN])}{', ...' if len(content.skipped) > SHOWN else ''}"
            why = "texts, more than two axes, axes that are curves, variants, read-only values, values that follow from others"
            say(f"{source}: {len(content.skipped):,} are left out ({why}): {names}")
    if sections.guessed:
        say(f"no usable range of {', '.join(sections.guessed)}: {100 * span:.0f} % around the value was taken; correct it")
    for name, reason in sections.left_out.items():
        say(f"{name}: left out: {reason}")
    missing = sections.parameters.keys() - sections.baseline.keys()
    if missing and sections.baseline:
        say(f"no file has a value of {', '.join(sorted(missing))}: complete the baseline, or remove it")


def _yaml(sections: Sections) -> Iterator[str]:
    yield "parameters:"
    for name, entry in sections.parameters.items():
        fields = ", ".join(f"{field}: {json.dumps(value, ensure_ascii=False)}" for field, value in entry.items())
        yield f"  {_key(name)}: {{{fields}}}"
    if sections.baseline:
        yield "baseline:"
        yield from (f"  {_key(name)}: {json.dumps(value, ensure_ascii=False)}" for name, value in sections.baseline.items())


def _key(name: str) -> str:
    return f'"{name}"' if name.lower() in {"null", "true", "false"} else name
