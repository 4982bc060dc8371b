"""Stores the multi-body vehicle's runs of the manoeuvres that rate the hybrid vehicle in its card: simulating them takes too long
for a test. After a change of `drivecal.highway.training.multibody` or of the manoeuvres: `python tests/golden/held_out.py`.

Whole numbers of the units below, as second differences over time, which take little room. What that rounds away is a hundredth of the
last digit of the card.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivecal.highway.training import vehicle
from drivecal.highway.training.multibody import Recording
from drivecal.highway.training.vehicle import BEGIN, STEPS, Drives
from drivecal.plugins.ports import Floats

FILE = Path(__file__).with_name("held_out.npz")
UNITS = {
    "steering_angle": 1e-7,
    "speed": 1e-5,
    "y": 1e-4,
    "heading": 1e-5,
    "side_slip": 1e-6,
    "yaw_rate": 1e-6,
    "lateral_acceleration": 1e-4,
}
"""rad, m/s, m, rad, rad, rad/s, m/s^2."""


def write(recordings: Sequence[Recording]) -> None:
    """From the end of the quiet second on."""
    rows = {name: np.array([getattr(recording, name)[BEGIN : BEGIN + STEPS + 1] for recording in recordings]) for name in UNITS}
    counts = {name: np.rint(values / UNITS[name]).astype(np.int64) for name, values in rows.items()}
    before = np.zeros((len(recordings), 2), dtype=np.int64)
    packed = {name: np.diff(one, n=2, axis=1, prepend=before).astype(np.int32) for name, one in counts.items()}
    everything: dict[str, Any] = {"kinds": np.array([recording.manoeuvre.kind for recording in recordings])} | packed
    np.savez_compressed(FILE, **everything)


def read() -> tuple[list[str], Drives]:
    """The manoeuvres' kinds and drives."""
    with np.load(FILE) as file:
        kinds = [str(kind) for kind in file["kinds"]]
        seen: dict[str, Floats] = {
            name: UNITS[name] * file[name].astype(np.int64).cumsum(axis=1).cumsum(axis=1) for name in UNITS
        }
    given = np.stack([seen["steering_angle"], seen["speed"]], axis=2)
    starts = np.column_stack([seen[name][:, 0] for name in ("heading", "side_slip", "yaw_rate")])
    aside = seen["y"] - seen["y"][:, :1]
    truth = np.stack([seen["yaw_rate"], seen["lateral_acceleration"], aside], axis=2)[:, 1:]
    return kinds, Drives(given, starts, truth)


if __name__ == "__main__":
    write(vehicle.held_out_drives())
