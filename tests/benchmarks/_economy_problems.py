"""Problems of the benchmark of economy, each with what a search by the cell is given of it, simulated in this process."""

from __future__ import annotations

import importlib.util
import json
import math
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from drivecal.analysis.aims import WeightedScore
from drivecal.analysis.scoring import rate
from drivecal.bundles.checks import checked, choices_of
from drivecal.bundles.expressions import Constraint, Formula
from drivecal.bundles.shapes import with_points
from drivecal.domain.constraints import Constraints
from drivecal.domain.parameters import Parameter, ParameterSpace
from drivecal.domain.regions import FeasibleRegion
from drivecal.domain.scales import COMFORT, Direction, Scale
from drivecal.domain.values import decimal
from drivecal.plugins.ports import Floats
from drivecal.plugins.search import AskedCell, CellAnswer, SearchTask

HERE = Path(__file__).parent / "problems"
EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples" / "problems"
Run = Callable[..., float | None]
"""Returns the rating of a set in a scenario, under a seed if the simulator is random; None for a failed run."""


@dataclass
class EconomyProblem:
    """A problem with one score. Answers are remembered, on disk too if there is a folder for them."""

    name: str
    space: ParameterSpace
    scenarios: Sequence[str]
    scale: Scale
    run: Run
    constraints: Constraints
    baseline: Mapping[str, Any] | None = None
    stored: Path | None = None
    _known: dict[tuple[int, ...], float | None] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        if self.stored is not None and self.stored.exists():
            for line in self.stored.read_text().splitlines():
                key, value = json.loads(line)
                self._known[tuple(key)] = value

    @cached_property
    def aim(self) -> WeightedScore:
        """The mean of the score over the scenarios."""
        return WeightedScore({name: 1 / len(self.scenarios) for name in self.scenarios}, self.scale)

    def task(self, cells: int | None, window: int = 1) -> SearchTask:
        """Returns what a search is given."""
        start = np.empty((0, len(self.space.searched)), dtype=np.int64)
        if self.baseline is not None:
            indices = [
                p.index(value if isinstance(value := self.baseline[p.name], str) else decimal(value))
                for p in self.space.searched
            ]
            start = np.array([indices], dtype=np.int64)
        return SearchTask(
            self.space.n_values,
            self.space.kinds,
            self.aim,
            self.region.feasible,
            self.region.repair,
            self.region.sample,
            start,
            (),
            cells,
            window,
        )

    @cached_property
    def region(self) -> FeasibleRegion:
        """The feasible sets."""
        return self.constraints.region(np.zeros_like(self.space.n_values), self.space.n_values - 1)

    def answer(self, cell: AskedCell, *seed: int) -> CellAnswer:
        """Returns the answer of a cell; `seed` of a random simulator."""
        key = (*cell.indices, cell.scenario, *seed)
        if key not in self._known:
            values = {p.name: _plain(p.named(index)) for p, index in zip(self.space.searched, cell.indices, strict=True)}
            value = self._known[key] = self.run(values, self.scenarios[cell.scenario], *seed)
            if self.stored is not None:
                self.stored.parent.mkdir(parents=True, exist_ok=True)
                with self.stored.open("a") as file:
                    file.write(json.dumps([key, value]) + "\n")
        value = self._known[key]
        return CellAnswer(cell, (self.scale.failed if value is None else value,), value is None)

    def objective(self, ratings: Sequence[float]) -> float:
        """Returns the objective of a set's ratings, higher is better."""
        return float(self.aim.judge(np.array(ratings).reshape(1, -1, 1))[0][0, 0])


def _plain(value: Any) -> float | str:
    return value if isinstance(value, str) else float(value)


def of_folder(folder: Path, runner: Callable[[Path, Mapping[str, Any]], Callable[..., Any]], **changes: Any) -> EconomyProblem:
    """Returns the problem in a folder, with other sections in its manifest."""
    document = yaml.safe_load((folder / "problem.yaml").read_text()) | changes
    manifest = checked(document)
    names = choices_of(manifest)
    space = ParameterSpace(
        tuple(
            Parameter.declared(
                name,
                lower=entry.lower,
                upper=entry.upper,
                step=entry.step,
                integer=entry.integer or False,
                choices=entry.choices,
            )
            for name, entry in manifest.scalars.items()
        )
    )
    known = {p.name: names.get(p.name, ()) for p in space.parameters}
    constraints = Constraints(space, {text: Constraint(text, known) for text in manifest.conditions})
    (name, score), *_ = manifest.scores.items()
    formula, scale = Formula(score.formula or ""), score.scale(name)
    simulate = runner(folder, document)

    def run(parameters: Mapping[str, Any], scenario: str) -> float | None:
        arguments = with_points(parameters, manifest.shapes, document["simulator"])
        answer = simulate(arguments, document["scenarios"][scenario])
        if answer.get("failure"):
            return None
        scored = rate(formula, scale, answer.get("measures", answer), None)
        return None if scored is None else scored.score

    return EconomyProblem(folder.name, space, tuple(document["scenarios"]), scale, run, constraints, manifest.start)


def in_python(folder: Path, document: Mapping[str, Any]) -> Callable[..., Any]:
    simulator = document["simulator"]
    specification = importlib.util.spec_from_file_location(f"economy_{folder.name}", folder / simulator["file"])
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    function: Callable[..., Any] = getattr(module, simulator.get("function", "evaluate"))
    return function


def _process(folder: Path, document: Mapping[str, Any]) -> Callable[..., Any]:
    building = Path(tempfile.mkdtemp(prefix="drivecal-economy-"))
    for source in ("Makefile", "acc.cpp"):
        (building / source).write_bytes((folder / source).read_bytes())
    subprocess.run(["make", "-s"], cwd=building, check=True)
    process = subprocess.Popen(["./acc"], cwd=building, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None
    assert process.stdout is not None
    to, back = process.stdin, process.stdout

    def exchange(message: Mapping[str, Any]) -> Any:
        to.write(json.dumps(message) + "\n")
        to.flush()
        return json.loads(back.readline())

    exchange({"drivecal": 1, "problem": document["problem"]})

    def simulate(parameters: Mapping[str, Any], scenario: Mapping[str, Any]) -> Any:
        whole = {name: int(value) if name == "delay" else value for name, value in parameters.items()}
        return exchange({"id": 1, "scenario": "x", "data": scenario, "parameters": whole})

    return simulate


def motorway(*, random: bool = False) -> EconomyProblem:
    """The built-in motorway, S1 to S6, or the random one, S1r to S6r."""
    from tests.benchmarks.evaluation import runner_of

    from drivecal.bundles.installed import installed_problems
    from drivecal.highway.comfort.reference import REFERENCE
    from drivecal.highway.planner.plugin import FRENET
    from drivecal.highway.scenarios import HIGHWAY, RANDOM_FOLDER, scenario_of

    declared = installed_problems()["highway-random"].manifest.scenarios if random else {}
    scenarios = {name: scenario_of(name, data, RANDOM_FOLDER) for name, data in declared.items()} or HIGHWAY.scenarios

    @lru_cache(240)
    def runner(scenario: str, *seed: int) -> Any:
        return runner_of(replace(scenarios[scenario], seed=seed[0]) if seed else scenarios[scenario])

    def run(parameters: Mapping[str, Any], scenario: str, *seed: int) -> float | None:
        result = runner(scenario, *seed).run(list(parameters.values()))
        return None if result.failure else float(REFERENCE.rate(scenarios[scenario].rated_as, result.measures).rating)

    searched = ParameterSpace(FRENET.spaces["highway"])
    name = "random_motorway" if random else "motorway"
    return EconomyProblem(name, searched, tuple(scenarios), COMFORT, run, Constraints(searched))


UNIT = Scale("cost", Direction.MINIMISE, lower=0.0, upper=10.0, tolerance=0.1, failed=20.0)


def _computed(
    name: str, n: int, scenarios: int, cost: Callable[[Floats, int], float | None], steps: Sequence[float | None]
) -> EconomyProblem:
    space = ParameterSpace(tuple(Parameter.declared(f"x{i}", lower=0, upper=1, step=steps[i % len(steps)]) for i in range(n)))

    def run(parameters: Mapping[str, Any], scenario: str) -> float | None:
        return cost(np.array(list(parameters.values())), int(scenario[1:]))

    return EconomyProblem(name, space, tuple(f"C{i}" for i in range(scenarios)), UNIT, run, Constraints(space))


def _few_matter(x: Floats, scenario: int) -> float | None:
    place = [(7 * scenario + 3 * k) % 5 for k in range(3)]
    wanted = 0.15 + 0.7 * np.array([0.5, 0.2, 0.9, 0.65, 0.35])
    off = x[[2, 7, 13, 19, 26]] - wanted
    bend = off[place[0]] + 0.5 * off[place[1]] * off[place[2]]
    return float(12 * bend**2 + 6 * abs(off[place[1]]) + 4 * off[place[2]] ** 2 + 0.4 * math.sin(9 * off[place[0]]) ** 2)


def _funnel(x: Floats, scenario: int) -> float | None:
    wanted: Floats = 0.35 + 0.3 * np.array([0.9, 0.1, 0.6, 0.3, 0.8, 0.45]) + 0.01 * scenario
    distance = float(np.sqrt(np.mean((x - wanted) ** 2)))
    depth: float = 6.0 * max(0.0, 1 - distance / 0.25) ** 1.5
    return 6.0 + 0.02 * scenario - depth + 0.1 * abs(math.sin(20 * float(x.sum())))


def _cliff(x: Floats, scenario: int) -> float | None:
    edge = 0.62 + 0.02 * scenario
    if 0.6 * x[0] + 0.4 * x[1] > edge:
        return None
    return float(
        8 * (1 - (0.6 * x[0] + 0.4 * x[1]) / edge)
        + 4 * (x[2] - 0.3 - 0.05 * scenario) ** 2
        + 3 * abs(x[3] - 0.7 * x[4])
        + 2 * (x[5] - 0.5) ** 2
    )


def choices() -> EconomyProblem:
    """Two choices with one best pair of values, and five numbers."""
    offsets = {"A": {"a": 1.2, "b": 0.9, "c": 0.0, "d": 1.6}, "B": {"a": 0.5, "b": 0.0, "c": 1.0}}
    numbers = [Parameter.declared(f"x{i}", lower=0, upper=1, step=0.01) for i in range(5)]
    space = ParameterSpace((*(Parameter.choice(name, tuple(values)) for name, values in offsets.items()), *numbers))

    def run(parameters: Mapping[str, Any], scenario: str) -> float | None:
        x = np.array([parameters[f"x{i}"] for i in range(5)])
        away = (1.5 + 0.3 * np.arange(5)) * (x - 0.3 - 0.05 * np.arange(5) - 0.03 * int(scenario[1:])) ** 2
        return float(0.5 + sum(values[parameters[name]] for name, values in offsets.items()) + away.sum())

    return EconomyProblem("choices", space, tuple(f"C{i}" for i in range(5)), UNIT, run, Constraints(space))


PROBLEMS: Mapping[str, Callable[[], EconomyProblem]] = {
    "motorway": motorway,
    "acc_curve": lambda: of_folder(HERE / "acc_curve", in_python),
    "monotone_curve": lambda: of_folder(HERE / "monotone_curve", in_python),
    "braking": lambda: of_folder(EXAMPLES / "python-function", in_python),
    "acc": lambda: of_folder(EXAMPLES / "acc-process", _process),
    "few_matter": lambda: _computed("few_matter", 30, 6, _few_matter, (None, 0.05)),
    "funnel": lambda: _computed("funnel", 6, 4, _funnel, (0.01,)),
    "cliff": lambda: _computed("cliff", 6, 5, _cliff, (None, 0.02)),
}


OTHERS: Mapping[str, Callable[[], EconomyProblem]] = {
    "random_motorway": lambda: motorway(random=True),
    "choices": choices,
    "emergency_brake": lambda: of_folder(HERE / "emergency_brake", in_python),  # as in the tutorial
}
"""Problems that are no part of the usual table."""


@cache
def problem(name: str, folder: Path | None = None) -> EconomyProblem:
    """Returns a problem of `PROBLEMS` or `OTHERS`, with its answers stored in a folder."""
    made = {**PROBLEMS, **OTHERS}[name]()
    return made if folder is None else replace(made, stored=folder / f"{name}.jsonl")
