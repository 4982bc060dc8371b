"""A stand-in for a licensed tool: each run, or each process with `--serve`, holds one of the licences, files that are locked.

It reports `taken: 0` if none was free, which is more runs at once than licences. `busy` instead has it answer that it is busy.
"""

import fcntl
import json
import os
import sys
import time
from pathlib import Path


def licence(folder: Path, pool: str) -> int | None:
    """Locks a free licence; the system frees it when this process ends, however that happens."""
    for file in sorted(folder.glob(f"{pool}-*.licence")):
        descriptor = os.open(file, os.O_RDONLY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            continue
        return descriptor
    return None


def run(parameters: dict[str, float], data: dict[str, float], taken: bool) -> dict[str, float]:
    begin = time.monotonic()
    time.sleep(float(data["seconds"]))
    return {"value": parameters["x"], "taken": float(taken), "begin": begin, "end": time.monotonic()}


def main() -> None:
    here = Path(sys.argv[1]).resolve().parent
    if sys.argv[2] == "--serve":
        pool, held = sys.argv[3], None
        for line in sys.stdin:
            request = json.loads(line)
            if "quit" in request:
                return
            if "id" not in request:
                held = licence(here, pool)
                answer: dict[str, object] = {"ready": True}
            else:
                measures = run(request["parameters"], request["data"], held is not None)
                answer = {"id": request["id"], "measures": measures}
            print(json.dumps(answer), flush=True)
        return
    pool, parameters, scenario, results = sys.argv[2:]
    data = json.loads(Path(scenario).read_text())
    held = licence(here, pool)
    if held is None and data.get("asks"):
        print("no licence is free", file=sys.stderr)
        sys.exit(75)
    measures = run(json.loads(Path(parameters).read_text()), data, held is not None)
    Path(results).write_text(json.dumps({"measures": measures}))


main()
