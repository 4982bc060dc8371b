"""Tables of the hybrid vehicle's model card, from its arrays and held-out manoeuvres."""

from collections.abc import Sequence

import numpy as np

from drivecal.highway.training import multibody
from drivecal.highway.training.drives import Drives, hybrid_plant
from drivecal.highway.training.multibody import Recording
from drivecal.highway.training.tables import table
from drivecal.highway.vehicle import equations
from drivecal.highway.vehicle.parameters import SingleTrackParameters
from drivecal.highway.vehicle.residual import Residual
from drivecal.plugins.ports import Floats

ERRORS, RANGE = "errors on held-out manoeuvres", "training range"
INPUTS = (
    ("lateral acceleration of the single track / g", "1"),
    ("its yaw acceleration, scaled", "1"),
    ("centripetal less lateral acceleration / g", "1"),
    ("front axle force gained in 0.1 s of steering / its load", "1"),
    ("speed", "m/s"),
    ("longitudinal acceleration / g", "1"),
)


def _root_mean_square(errors: Floats) -> Floats:
    return np.asarray(np.sqrt((errors**2).mean(axis=0)))


def kinds_of(recordings: Sequence[Recording]) -> list[str]:
    """Returns the kinds of recorded manoeuvres."""
    return [recording.manoeuvre.kind for recording in recordings]


def errors(residual: Residual, kinds: Sequence[str], drives: Drives) -> dict[str, Floats]:
    """Returns r.m.s. errors by vehicle (`plain`, `hybrid`, `converted`) and, for the first two, by `plain kind` and `hybrid kind`.

    Each of shape (3,): yaw rate (rad/s), lateral acceleration (m/s^2), lateral position after 4 s (m).
    """
    kind_of_drive = np.array(kinds)
    baseline = SingleTrackParameters(*residual.baseline.tolist())
    means = {"converted": _root_mean_square(drives.errors(equations.pack_plant(multibody.converted())))}
    plants = {"plain": equations.pack_plant(baseline), "hybrid": hybrid_plant(baseline, residual)}
    for name, plant in plants.items():
        by_drive = drives.errors(plant)
        means[name] = _root_mean_square(by_drive)
        means |= {f"{name} {kind}": _root_mean_square(by_drive[kind_of_drive == kind]) for kind in dict.fromkeys(kinds)}
    return means


def error_table(residual: Residual, kinds: Sequence[str], drives: Drives) -> str:
    """Returns the table of errors of the plain and the hybrid vehicle, by kind of manoeuvre."""
    means = errors(residual, kinds, drives)

    def row(label: str, count: int, plain: Floats, hybrid: Floats) -> list[str]:
        cells = [
            f"{a * scale:.{digits}f} to {b * scale:.{digits}f}"
            for a, b, scale, digits in zip(plain, hybrid, (1e3, 1, 1), (2, 3, 2), strict=True)
        ]
        return [label, str(count), *cells]

    rows = [row(kind, kinds.count(kind), means[f"plain {kind}"], means[f"hybrid {kind}"]) for kind in dict.fromkeys(kinds)]
    rows.append(row("all", len(kinds), means["plain"], means["hybrid"]))
    rows.append(["hybrid / plain", "", *(f"{value:.2f}" for value in means["hybrid"] / means["plain"])])
    mrad, across, aside = means["converted"] * (1e3, 1.0, 1.0)
    rows.append(["single track as the package converts it", str(len(kinds)), f"{mrad:.2f}", f"{across:.3f}", f"{aside:.2f}"])
    return table(
        ["plain to hybrid", "manoeuvres", "yaw rate, mrad/s", "lateral acceleration, m/s^2", "lateral position after 4 s, m"],
        rows,
    )


def range_table(residual: Residual) -> str:
    """Returns the table of the residual's training range; outside of it the vehicle is the plain one."""
    centre, reach = residual.speed
    rows = []
    for (name, unit), limit in zip(INPUTS, residual.limits, strict=True):
        bounds = (
            f"{centre - limit * reach:.1f} to {centre + limit * reach:.1f}"
            if unit == "m/s"
            else f"up to {limit:.3f} either way"
        )
        rows.append([name, unit, bounds])
    rows.append(["added lateral acceleration / g", "1", f"cut at {residual.bounds[0]:.3f}"])
    rows.append(["added yaw acceleration, scaled", "1", f"cut at {residual.bounds[1]:.3f}"])
    return table(["quantity", "unit", "in training"], rows)
