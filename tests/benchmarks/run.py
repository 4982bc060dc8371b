"""Runs the benchmarks next to this file, all or those named: `python tests/benchmarks/run.py [NAME ...] [OPTION ...]`.

The benchmark defines the options: `run.py reuse --help`. Each benchmark is a program and runs in its own process, because a process holds
one simulation and memory figures shall not add up. It prints a table, writes its figures to `.drivecal/bench/NAME.json` and exits with 0
if the figures are good enough. After a failure the other benchmarks still run.
"""

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path

HERE = Path(__file__).parent


def available() -> list[str]:
    """The names of all benchmarks."""
    return sorted(path.stem for path in HERE.glob("*.py") if path.name != Path(__file__).name and not path.stem.startswith("_"))


def main(arguments: Sequence[str]) -> int:
    """Runs the benchmarks of these names, all where none is given, with the options that follow the names; 0 where every one of them
    ended with 0, 2 for an unknown name."""
    given = list(takewhile(lambda one: not one.startswith("-"), arguments))
    options = arguments[len(given) :]
    # a file named random.py would hide the standard library's from its neighbours
    names = [{"random": "random_runs"}.get(name, name) for name in given]
    if options and len(names) != 1:
        print("options are those of one benchmark: run.py NAME OPTION ...", file=sys.stderr)
        return 2
    unknown = [name for name in names if name not in available()]
    if unknown:
        print(f"there is no benchmark {', '.join(unknown)}; available: {', '.join(available())}", file=sys.stderr)
        return 2
    # benchmarks share parts with each other and with the tests, as `tests.benchmarks` and `tests.support`
    env = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [str(HERE.parents[1]), os.environ.get("PYTHONPATH")]))}
    ended: dict[str, tuple[int, float]] = {}
    for name in names or available():
        print(f"\n{name}\n{'=' * len(name)}", flush=True)
        started = time.perf_counter()
        code = subprocess.run([sys.executable, str(HERE / f"{name}.py"), *options], env=env, check=False).returncode
        ended[name] = (code, time.perf_counter() - started)
    print()
    for name, (code, seconds) in ended.items():
        print(f"{name:20} {seconds:7.1f} s  {'good' if code == 0 else f'not good enough (exit {code})'}")
    return int(any(code for code, _ in ended.values()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
