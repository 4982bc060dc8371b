"""Trains the learned parts and rewrites the tables of their model cards: `python -m drivecal.highway.training [vehicle] [comfort]`."""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path


def train_vehicle() -> None:
    """Trains the hybrid vehicle's residual."""
    from drivecal.highway.training import vehicle
    from drivecal.highway.training.tables import write_table
    from drivecal.highway.training.vehicle import Drives
    from drivecal.highway.vehicle.residual import FILE

    _print("driving the multi-body vehicle")
    drives = Drives.of(vehicle.training_drives())
    baseline = vehicle.fit_baseline(drives)
    _print("fitting the residual")
    residual = vehicle.fit_residual(drives, baseline)
    residual.write(FILE)
    _print("driving the held-out manoeuvres")
    card = FILE.with_suffix(".md")
    held_out = vehicle.held_out_drives()
    errors = vehicle.error_table(residual, [drive.manoeuvre.kind for drive in held_out], Drives.of(held_out))
    write_table(card, vehicle.ERRORS, errors)
    write_table(card, vehicle.RANGE, vehicle.range_table(residual))
    _print(errors, FILE)


def train_comfort() -> None:
    """Trains the learned comfort evaluator."""
    from drivecal.highway.comfort.reference import Manoeuvre
    from drivecal.highway.comfort.regressions import FILE, write
    from drivecal.highway.training import comfort
    from drivecal.highway.training.tables import write_table

    _print("driving the training manoeuvres")
    drives = comfort.drives(held_out=False)
    panel = comfort.rated_by_panel(drives)
    regressions = {}
    for manoeuvre in Manoeuvre:
        _print(f"fitting {manoeuvre.value}")
        places = [place for place, drive in enumerate(drives) if drive.manoeuvre is manoeuvre]
        regressions[manoeuvre] = comfort.fit([drives[place] for place in places], panel[places], comfort.SEED)
    write(FILE, regressions)
    _print("driving the held-out manoeuvres")
    card, held_out = FILE.with_suffix(".md"), comfort.drives(held_out=True)
    ratings = comfort.ratings(regressions, held_out)
    agreement = comfort.agreement_table(ratings, held_out)
    write_table(card, comfort.AGREEMENT, agreement)
    write_table(card, comfort.CALIBRATION, comfort.calibration_table(ratings, held_out))
    _print(agreement, FILE)


PARTS: dict[str, Callable[[], None]] = {"vehicle": train_vehicle, "comfort": train_comfort}


def _print(text: str, file: Path | None = None) -> None:
    sys.stdout.write(f"{text}\n" + (f"written: {file.name} and {file.stem}.md\n" if file else ""))
    sys.stdout.flush()


def main(arguments: list[str] | None = None) -> int:
    """Trains the named parts, by default all of them."""
    parser = argparse.ArgumentParser(prog="python -m drivecal.highway.training", description=__doc__)
    parser.add_argument("parts", nargs="*", help="vehicle, comfort; both by default")
    chosen = parser.parse_args(arguments).parts or list(PARTS)
    unknown = [part for part in chosen if part not in PARTS]
    if unknown:
        parser.error(f"there is no {unknown[0]!r} to train; choose from {', '.join(PARTS)}")
    for part in chosen:
        begin = time.perf_counter()
        PARTS[part]()
        _print(f"{part}: {time.perf_counter() - begin:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
