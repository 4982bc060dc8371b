"""Measures what reuse saves in a first campaign, its own cost included: `python tests/benchmarks/run.py reuse [--seeds 10] [...]`.

`--pairs` prints for each campaign its printed and its true net saving, i.e. the CPU time of `off` less its own. Both are of all
processes: workers, dispatcher, API, supervisor. `--of function` takes a function of 10 ms in the place of the built-in problem.

Campaigns of the paper's size (1,000 individuals, 20 iterations, six scenarios) with each kind of reuse and with none (`off`), each on a
database of its own, with ready workers, in a turning order, for every seed. Runs, CPU time (workers and predictor) and wall time last to
the confirmed optimum: sensitivity analysis, samples, walks, fits, audits and confirmation are in them. Ratios and differences are paired
by seed, with 95 % t-intervals.

A seed takes 15 to 20 minutes on two cores. Every finished campaign adds a line to `docs/pages/results/data/reuse.jsonl`, with the machine,
the versions and the commit of the code, so that seeds of several days add up: campaigns of the same code and machine are not made again.
`--commit` includes campaigns of other commits. `--counts` prints only runs and optima, which do not depend on the machine: of
campaigns on all machines and under any load.
"""

import argparse
import ctypes
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import yaml
from scipy.stats import t as student
from tests.benchmarks.efficiency import wait_for_workers
from tests.support.faults.cage import PR_SET_CHILD_SUBREAPER

from drivecal.cli.commands.demo import coordinator, fresh_folder
from drivecal.contracts.campaign import Campaign

HOME = Path(".drivecal/bench/reuse").absolute()
TARGET = Path("docs/pages/results/data/reuse.jsonl")
CODE = ("services", "shared", "workers", "pyproject.toml")
"""Paths whose last commit names the code."""
PACKAGES = ("drivecal", "numpy", "scikit-learn", "libsumo", "ray")
KINDS: dict[str, dict[str, Any]] = {
    "off": {"reduction": {"mode": "off", "confirm": 0}},
    "exact": {"reduction": {"mode": "exact", "confirm": 20}},
    "influence": {"sensitivity": {}, "reduction": {"mode": "influence", "confirm": 20}},
    "predicted": {"reduction": {"mode": "predicted", "confirm": 20}},
    "predicted, a point off": {"reduction": {"mode": "predicted", "confirm": 20, "tolerance": 1, "limit": 0.01}},
}
PROBLEMS: dict[str, dict[str, Any]] = {"motorway": {}, "function": {"problem": "function"}}
PAPER = 1000, 20
"""The paper's size: individuals and iterations."""
WANTED = {"predicted": {"runs": 0.60}, "predicted, a point off": {"runs": 0.40}}
"""Largest mean ratios to `off`, at the paper's size."""
WANTED_ELSEWHERE = {"wall": 1.05}
"""Largest mean ratios of every kind with predictions, at any other size: a small search may save less, but not lose."""
MARGIN = 1 / 12
"""Largest mean loss of the confirmed optimum, in points."""
OFF_BY = 0.1, 1.0
"""Largest error of the printed net saving: a share of the true one, or seconds."""
LEAST_NET = -0.02
"""Smallest net saving, as a share of the CPU time of `off`."""
FUNCTION = """
import time

def evaluate(parameters, data):
    end, number = time.process_time() + 0.01, data["number"]
    while time.process_time() < end:
        pass
    return {"miss": sum(((x - 0.1 * number) * (1 + place % 3)) ** 2 for place, x in enumerate(parameters.values()))}
"""
MANIFEST = {
    "problem": "function",
    "parameters": {f"x{place}": {"lower": 0, "upper": 1} for place in range(6)},
    "simulator": {"kind": "python", "file": "function.py", "function": "evaluate", "deterministic": True},
    "scenarios": {f"S{number}": {"number": number} for number in range(1, 7)},
    "measures": {"miss": "1"},
    "scores": {"best": {"formula": "miss", "direction": "minimise", "range": [0, 30], "tolerance": 0.5}},
}


@dataclass(frozen=True, slots=True)
class Circumstances:
    """Describes what a campaign was measured with. Lines of earlier releases say nothing of it."""

    commit: str = ""
    """Last commit of the code, with a plus sign if files differ from it."""
    machine: str = ""
    cores: int = 0
    versions: Mapping[str, str] = field(default_factory=dict)

    @staticmethod
    def here() -> "Circumstances":
        """Returns the circumstances of this process."""
        commit = _git("log", "-1", "--format=%h", "--", *CODE) + "+" * bool(_git("status", "--porcelain", "--", *CODE))
        models = [line.split(":", 1)[1].strip() for line in _cpu_lines() if line.startswith("model name")]
        versions = {"python": platform.python_version()} | {package: version(package) for package in PACKAGES}
        return Circumstances(commit, models[0] if models else platform.machine(), os.cpu_count() or 0, versions)


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], capture_output=True, text=True, check=True).stdout.strip()


def _cpu_lines() -> list[str]:
    path = Path("/proc/cpuinfo")
    return path.read_text(encoding="utf-8").splitlines() if path.exists() else []


@dataclass(frozen=True, slots=True)
class Outcome:
    """A campaign, from submission to the confirmed optimum: simulations of all stages, CPU and wall seconds."""

    kind: str
    seed: int
    population: int
    iterations: int
    runs: int
    cpu: float
    wall: float
    best: float
    released: int
    rejected: int
    day: str = ""
    net: float = 0.0
    """The printed net saving, in seconds."""
    measured_with: Circumstances = Circumstances()

    @staticmethod
    def read(line: str) -> "Outcome":
        """Reads a stored line, of earlier releases too."""
        document = json.loads(line)
        return Outcome(**document | {"measured_with": Circumstances(**document.get("measured_with", {}))})


class CpuTime:
    """The CPU time of the processes that this one started, and of theirs: of each as it was last seen."""

    def __init__(self) -> None:
        self._seen: dict[psutil.Process, float] = {}
        self._before = self._sum()

    def _sum(self) -> float:
        for process in psutil.Process().children(recursive=True):
            with suppress(psutil.Error):
                self._seen[process] = sum(process.cpu_times()[:2])
        return sum(self._seen.values())

    def seconds(self) -> float:
        """Returns the CPU time since this was made. Call it often: a process may end."""
        return self._sum() - self._before


def carry_out(specification: Mapping[str, Any]) -> tuple[Campaign, float, float]:
    """Carries a campaign out on a new database, with workers that are ready before; returns it with the CPU time of all processes and its
    printed net saving (s)."""
    with fresh_folder(HOME), coordinator(HOME) as client:
        if "problem" in specification:
            (HOME / "function").mkdir()
            (HOME / "function" / "function.py").write_text(FUNCTION, encoding="utf-8")
            (HOME / "function" / "problem.yaml").write_text(yaml.safe_dump(MANIFEST), encoding="utf-8")
            client.push_problem(HOME / "function")
        wait_for_workers(client)
        cpu = CpuTime()
        campaign = client.submit(dict(specification))
        while campaign.state not in {"succeeded", "failed", "cancelled"}:
            cpu.seconds()
            time.sleep(0.5)
            campaign = client.campaign(campaign.id)
        if campaign.state != "succeeded":
            raise RuntimeError(f"the campaign ended as {campaign.state}: {campaign.error}")
        spent = cpu.seconds()
        accounting = client.results(campaign.id).accounting
        return campaign, spent, 0.0 if accounting is None else accounting.net_seconds


def measured(kind: str, seed: int, size: tuple[int, int], of: str, circumstances: Circumstances) -> Outcome:
    """Carries a campaign out."""
    optimizer = {"kind": "genetic", "population": size[0], "iterations": size[1], "seed": seed}
    specification = {"name": kind, "sensitivity": None, "optimizer": optimizer} | PROBLEMS[of] | KINDS[kind]
    campaign, cpu, net = carry_out(specification)
    if campaign.best is None:
        raise RuntimeError(f"{kind}, seed {seed}: no set has a result in every scenario")
    return Outcome(
        kind,
        seed,
        *size,
        sum(cells.simulated + cells.failed for cells in campaign.stages.values()),
        cpu,
        campaign.seconds.wall,
        campaign.best.objective,
        sum(lots.predicted for lots in campaign.released.values()),
        sum(lots.rejected for lots in campaign.released.values()),
        datetime.now(UTC).date().isoformat(),
        net,
        circumstances,
    )


def interval(values: Sequence[float]) -> tuple[float, float, float]:
    """Returns mean and 95 % t-interval, which is empty for a single value."""
    numbers = np.array(values, dtype=np.float64)
    mean = float(numbers.mean())
    if len(numbers) < 2:
        return mean, mean, mean
    half = float(student.ppf(0.975, len(numbers) - 1) * numbers.std(ddof=1) / np.sqrt(len(numbers)))
    return mean, mean - half, mean + half


def table(outcomes: Mapping[tuple[str, int], Outcome], seeds: Sequence[int], names: Sequence[str]) -> Iterator[str]:
    """Yields a line per kind: ratios of `names` to `off`, and the difference of the optimum."""
    yield f"{'':36}{''.join(f'{name:>24}' for name in names)}{'optimum, points':>30}"
    for kind in KINDS:
        pairs = [(outcomes[kind, seed], outcomes["off", seed]) for seed in seeds if (kind, seed) in outcomes]
        if pairs:
            ratios = (interval([getattr(one, name) / getattr(off, name) for one, off in pairs]) for name in names)
            shown = "".join(f"{mean:>9.3f} ({low:.3f}, {high:.3f})" for mean, low, high in ratios)
            mean, low, high = interval([one.best - off.best for one, off in pairs])
            yield f"{kind:36}{shown}{mean:>+12.4f} ({low:+.4f}, {high:+.4f})"


def pairs(outcomes: Mapping[tuple[str, int], Outcome], seeds: Sequence[int]) -> Iterator[str]:
    """Yields a line for each campaign: printed and true net saving, the latter as a share of `off`, and what is not as wanted."""
    yield f"{'':36}{'printed net':>14}{'true net':>14}{'of off':>10}{'runs':>16}"
    for (kind, seed), each in outcomes.items():
        if kind == "off" or seed not in seeds:
            continue
        off = outcomes["off", seed]
        true = off.cpu - each.cpu
        wrong = " printed wrongly" * (abs(each.net - true) > max(OFF_BY[0] * abs(true), OFF_BY[1]))
        wrong += " a loss" * (true < LEAST_NET * off.cpu)
        runs = f"{each.runs:,} of {off.runs:,}"
        yield f"{f'{kind}, seed {seed}':36}{each.net:>12.1f} s{true:>12.1f} s{100 * true / off.cpu:>8.1f} %{runs:>16}{wrong}"


def wanted(kind: str, size: tuple[int, int]) -> Mapping[str, float]:
    """Returns the largest mean ratios of a kind to `off`, at a size: population and iterations."""
    if size != PAPER:
        return WANTED_ELSEWHERE if "predicted" in kind else {}
    return WANTED.get(kind, {})


def missed(
    outcomes: Mapping[tuple[str, int], Outcome], seeds: Sequence[int], names: Sequence[str], size: tuple[int, int]
) -> list[str]:
    """Returns what is not as wanted."""
    problems = []
    for kind in KINDS:
        pairs = [(outcomes[kind, seed], outcomes["off", seed]) for seed in seeds if (kind, seed) in outcomes]
        if not pairs:
            continue
        for name, most in wanted(kind, size).items():
            if name not in names:
                continue
            mean, _, _ = interval([getattr(one, name) / getattr(off, name) for one, off in pairs])
            if mean > most:
                problems.append(f"{kind}: {name} {mean:.3f} of off, at most {most} wanted")
        worse, _, _ = interval([off.best - one.best for one, off in pairs])
        if worse > MARGIN:
            problems.append(f"{kind}: the optimum is {worse:.4f} worse, at most {MARGIN:.4f} wanted")
    return problems


def main(arguments: list[str]) -> int:
    """Prints the table; 1 if something is not as wanted."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--population", type=int, default=PAPER[0])
    parser.add_argument("--iterations", type=int, default=PAPER[1])
    parser.add_argument("--only", action="append", choices=list(KINDS), help="besides off")
    parser.add_argument("--file", type=Path, default=TARGET, help="of finished campaigns, a line each")
    parser.add_argument("--commit", action="append", default=[], help="whose campaigns count besides those of the current code")
    parser.add_argument("--of", choices=list(PROBLEMS), default="motorway", help="with --pairs")
    parser.add_argument("--pairs", action="store_true", help="printed and true net savings alone; no campaign is kept")
    parser.add_argument("--counts", action="store_true", help="runs and optima alone; campaigns of any machine count")
    given = parser.parse_args(arguments)
    os.environ["DRIVECAL_HOME"] = str(HOME)  # whose secret pushes problems
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)  # else the simulators, whose keepers are orphans, are not seen
    names = ("runs",) if given.counts else ("runs", "cpu", "wall")
    kinds = [kind for kind in KINDS if kind == "off" or given.only is None or kind in given.only]
    given.file.parent.mkdir(parents=True, exist_ok=True)
    known = map(Outcome.read, given.file.read_text(encoding="utf-8").splitlines() if given.file.exists() else [])
    here, size = Circumstances.here(), (given.population, given.iterations)
    outcomes = {
        (item.kind, item.seed): item
        for item in known
        if (item.population, item.iterations) == size
        and (given.counts or item.measured_with.machine in {here.machine, ""})
        and item.measured_with.commit in {here.commit, *given.commit}
    }
    seeds = range(1, given.seeds + 1)
    if given.pairs:
        outcomes = {}
    for seed in seeds:
        turned = [*kinds[seed % len(kinds) :], *kinds[: seed % len(kinds)]]
        for kind in turned:
            if (kind, seed) not in outcomes:
                outcome = outcomes[kind, seed] = measured(kind, seed, size, given.of, here)
                if not given.pairs:
                    with given.file.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(asdict(outcome)) + "\n")
                print(f"seed {seed}, {kind}: {outcome.runs:,} runs, {outcome.wall:.0f} s, best {outcome.best:.4f}", flush=True)
    print()
    if given.pairs:
        lines = list(pairs(outcomes, seeds))
        print("\n".join(lines))
        return int(any(line.endswith(("wrongly", "loss")) for line in lines))
    print("\n".join(table(outcomes, seeds, names)))
    problems = missed(outcomes, seeds, names, size)
    print("\n".join(problems))
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
