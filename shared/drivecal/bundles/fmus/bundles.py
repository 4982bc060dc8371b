"""Checks of a whole bundle against the FMUs among its files."""

from collections.abc import Iterator, Mapping
from itertools import islice

from drivecal.bundles.archives import BundleFile
from drivecal.bundles.fmus import checks
from drivecal.bundles.fmus.description import read_fmu
from drivecal.bundles.highway import FmuController, HighwaySimulator
from drivecal.bundles.manifest import FmuSimulator, Manifest
from drivecal.domain.errors import InvalidInputError, Problem

MOST_PROBLEMS = 100
"""Problems and notes of an FMU, which may have a hundred thousand inputs."""


def check_fmus(manifest: Manifest, files: Mapping[str, BundleFile]) -> tuple[str, ...]:
    """Returns notes on the FMUs among the files of a bundle. Raises InvalidInputError with all that does not fit.

    An FMU that cannot be read is left to the worker's FMPy, which says why, or reads it.
    """
    parameters = manifest.arguments
    parameters |= {name: entry.unit for name, entry in manifest.varied.items()}
    problems: list[Problem] = []
    notes: list[str] = []
    for field, section in fmu_sections(manifest):
        variables = read_fmu(files[section.file].content) if section.file in files else None
        if variables is None:
            continue
        if isinstance(section, FmuSimulator):
            problems += checks.unit_problems(variables, parameters)
            data = [
                (f"scenarios.{name}.{key}", key, value)
                for name, given in manifest.scenarios.items()
                for key, value in given.items()
            ]
            problems += islice(checks.value_problems(variables, data), MOST_PROBLEMS)
            measured = [(name, *checks.reduction_of(text)) for name, text in section.measures.items()]
            outputs = [
                (f"measures.{name}", output, manifest.measures.get(name, "1"), kind == "integral")
                for name, kind, output in measured
            ]
            outputs += [(f"series.{name}", name, unit, False) for name, unit in manifest.series.items()]
            problems += checks.output_problems(variables, outputs)
            used = {*(output for _, output, *_ in outputs), section.seed or "", *(key for _, key, _ in data)}
        else:
            problems += islice(checks.section_problems(field, section.model_dump(), variables, parameters), MOST_PROBLEMS)
            notes += islice(checks.input_notes(field, section.model_dump(), variables), MOST_PROBLEMS)
            used = {*section.signals.values(), *(section.constants or {})}
        problems += islice(checks.value_problems(variables, _ends(manifest)), MOST_PROBLEMS)
        notes += [*checks.unit_notes(variables, parameters), *checks.unused_notes(field, used | set(parameters), variables)]
    if problems:
        raise InvalidInputError(*dict.fromkeys(problems))
    return tuple(dict.fromkeys(notes))


def _ends(manifest: Manifest) -> Iterator[tuple[str, str, object]]:
    """Yields field, name and value of the ends and steps of all parameters' ranges, or of their choices."""
    for name, entry in manifest.scalars.items():
        step = None if entry.integer or entry.choices else entry.step or checks.ANY_NUMBER
        given = {"lower": entry.lower, "upper": entry.upper, "step": step}
        for key, value in given.items():
            if value is not None:
                yield f"parameters.{name}.{key}", name, value
        yield from ((f"parameters.{name}.choices[{index}]", name, choice) for index, choice in enumerate(entry.choices or ()))
    for name, varied in manifest.varied.items():
        for key in ("nominal", "lower", "upper"):
            yield f"varied.{name}.{key}", name, getattr(varied, key)


def fields_of_resets(manifest: Manifest) -> list[str]:
    """Returns the fields of the FMUs that are reset between runs; none if each run has a new process."""
    return [] if manifest.simulator.renews else [field for field, _ in fmu_sections(manifest)]


def fmu_sections(manifest: Manifest) -> Iterator[tuple[str, FmuSimulator | FmuController]]:
    """Yields the parts of a problem that are FMUs, with their fields."""
    simulator = manifest.simulator
    if isinstance(simulator, FmuSimulator):
        yield "simulator", simulator
    elif isinstance(simulator, HighwaySimulator) and isinstance(simulator.controller, FmuController):
        yield "simulator.controller", simulator.controller
