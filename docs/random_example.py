"""Draws the pictures of the example of a random simulator, and prints the true mean of its best set.

python docs/random_example.py ID FOLDER [URL]     # the campaign and the folder `cruise` of how-to/random-example.md
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from itertools import accumulate
from pathlib import Path
from runpy import run_path
from statistics import mean, stdev

import yaml

from drivecal.client import Client
from drivecal.contracts.tables import Solution

MEDIA = Path(__file__).parent / "pages" / "media"
BLUE, RED = "#0072b2", "#d55e00"
COURSE = "The course of the best set: a steep fall, then nearly flat, and at the end the interval of the runs that report it"
SEEDS = "The first sets of the ranking: the interval of each, and the seeds under which it ran"
SHOWN = 16
OTHER_SEEDS = range(1_001, 3_001)


def written(name: str, title: str, height: int, parts: Iterator[str]) -> None:
    """Writes a picture."""
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 790 {height}" font-family="sans-serif" font-size="14" fill="#222222">'
    back = f'<rect width="790" height="{height}" rx="8" fill="#ffffff"/>'
    (MEDIA / name).write_text("\n".join([head, f"<title>{title}</title>", back, *parts, "</svg>\n"]))


def course(points: list[tuple[int, float]], start: float, best: Solution) -> Iterator[str]:
    """The best objective over simulations, as it was believed, and the report of the best set."""

    def across(simulations: float) -> float:
        return 60 + 650 * simulations / 600

    def down(cost: float) -> float:
        return 226 - 23.6 * (cost - 4)

    for cost in (4, 6, 8, 10, 12):
        at = down(cost)
        yield f'<text x="52" y="{at + 5:.0f}" text-anchor="end">{cost}</text><path d="M60 {at:.0f}H710" stroke="#dddddd"/>'
    for simulations in range(0, 601, 100):
        yield f'<text x="{across(simulations):.0f}" y="270" text-anchor="middle">{simulations}</text>'
    yield '<text x="385" y="290" text-anchor="middle">simulations</text><text x="60" y="18">cost (less is better)</text>'
    yield f'<path d="M60 {down(start):.0f}H710" stroke="#999999" stroke-dasharray="3 4"/>'
    yield f'<text x="571" y="{down(start) + 18:.0f}">baseline</text>'
    line = "".join(f"H{across(simulations):.0f}V{down(cost):.1f}" for simulations, cost in points)
    yield f'<path d="M{across(0):.0f} {down(points[0][1]):.1f}{line}" stroke="{BLUE}" stroke-width="2" fill="none"/>'
    yield from interval(710, (best.lower or 0.0, best.objective, best.upper or 0.0), down)
    yield f'<text x="696" y="{down(best.objective) + 17:.0f}" text-anchor="end" fill="{RED}">report: eight seeds, 95 % interval</text>'


def interval(x: int, ends: tuple[float, float, float], down: Callable[[float], float]) -> Iterator[str]:
    """A mean with its interval, upright."""
    lower, middle, upper = (f"{down(end):.1f}" for end in ends)
    yield f'<path d="M{x} {lower}V{upper}M{x - 6} {lower}h12M{x - 6} {upper}h12" stroke="{RED}" stroke-width="2"/>'
    yield f'<circle cx="{x}" cy="{middle}" r="4" fill="{RED}"/>'


def seeds(ranked: list[Solution]) -> Iterator[str]:
    """Means, intervals and seeds of sets."""

    def across(cost: float) -> float:
        return 70 + 400 * (cost - 3) / 6

    heads = ((20, "rank"), (70, "cost, mean and 95 % interval"), (510, "seeds"))
    yield "".join(f'<text x="{x}" y="26" font-weight="bold">{text}</text>' for x, text in heads)
    for cost in range(3, 10):
        x = f"{across(cost):.0f}"
        yield f'<text x="{x}" y="{76 + 18 * SHOWN}" text-anchor="middle">{cost}</text>'
        yield f'<path d="M{x} 36V{58 + 18 * SHOWN}" stroke="#dddddd"/>'
    for place, each in enumerate(ranked):
        y, colour = 50 + 18 * place, RED if place == 0 else BLUE
        chosen = each.replicates if place else each.replicates - len(each.seeds)
        ends = f"M{across(each.lower or 0):.0f} {y}H{across(each.upper or 0):.0f}"
        yield (
            f'<text x="50" y="{y + 5}" text-anchor="end">{each.rank}</text><path d="{ends}" stroke="{colour}" stroke-width="2"/>'
            f'<circle cx="{across(each.objective):.0f}" cy="{y}" r="4" fill="{colour}"/>'
            f'<rect x="510" y="{y - 6}" width="{11 * chosen}" height="12" fill="{BLUE}"/>'
            f'<rect x="{510 + 11 * chosen}" y="{y - 6}" width="{11 * (each.replicates - chosen)}" height="12" fill="{RED}"/>'
            f'<text x="{518 + 11 * each.replicates}" y="{y + 5}">{each.replicates}</text>'
        )


def main(identifier: str, folder: Path, url: str | None = None) -> None:
    """Draws and prints."""
    with Client(url) as client:
        campaign, ranked = client.campaign(identifier), client.solutions(identifier, limit=1000).items
        generations = list(client.rows(identifier, "generations"))
    counted = accumulate(row["simulated"] for row in generations)
    points = [(runs, row["best"]) for runs, row in zip(counted, generations, strict=True) if row["best"] is not None]
    best, baseline = campaign.best, campaign.baseline
    if best is None or baseline is None or baseline.objective is None:
        raise SystemExit("the campaign has no best set, or no baseline")
    written("random-course.svg", COURSE, 300, course(points, baseline.objective, ranked[0]))
    written("random-seeds.svg", SEEDS, 88 + 18 * SHOWN, seeds(ranked[:SHOWN]))
    problem = yaml.safe_load((folder / "problem.yaml").read_text())
    evaluate = run_path(str(folder / "model.py"))["evaluate"]
    costs = []
    for seed in OTHER_SEEDS:
        runs = [evaluate(best.parameters, {**scenario, "seed": seed}) for scenario in problem["scenarios"].values()]
        costs.append(
            mean(
                120.0 if "failure" in run else 10 * run["peak_acceleration"] + 2 * max(0, 15 - run["smallest_gap_m"])
                for run in runs
            )
        )
    error = stdev(costs) / len(costs) ** 0.5
    counts = [each.replicates for each in ranked]
    print(f"true mean {mean(costs):.2f} (standard error {error:.2f}); reported {best.objective:.2f}")
    often = sum(count >= 12 for count in counts)
    print(f"{len(counts)} sets under 1 to {max(counts)} seeds: {counts.count(1)} once, {often} 12 times or more")
    print(f"second set: runs_to_tell {ranked[1].runs_to_tell}, objective {ranked[1].objective:.2f}")


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), *sys.argv[3:4])
