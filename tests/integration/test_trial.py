"""What a worker has done before it counts as ready."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

WARM_THEN_WORK = """
import gc, json
from drivecal.campaigns.resolve.problem import resolve
from drivecal.campaigns.resolve.problem import trial
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import Batch, Cell
from drivecal.runtime.worker import Worker

def compiled():
    from numba.core.dispatcher import Dispatcher
    found = [one for one in gc.get_objects() if isinstance(one, Dispatcher) and one.__module__.startswith("drivecal.")]
    return {f"{one.__module__}.{one.__qualname__}": len(one.signatures) for one in found}

worker = Worker("worker-1")
worker.warm(trial())
before = compiled()
problem = resolve(CampaignSpecification())
last = [one.n_values - 1 for one in problem.space.searched]
corners = [problem.space.parameter_set(row).floats for row in ([0] * len(last), [n // 3 for n in last], last)]
cells = tuple(Cell(number, values) for number, values in enumerate(corners))
results = [one for request in problem.bench.requests.values() for one in worker.run(Batch(request, cells)).results]
print(json.dumps([before, compiled(), [one.detail for one in results if one.breakdown], len(results)]))
"""


@pytest.mark.slow
def test_after_its_trial_a_worker_compiles_nothing_more_in_any_scenario() -> None:
    done = subprocess.run([sys.executable, "-c", WARM_THEN_WORK], capture_output=True, text=True, check=True)
    before, after, broken, results = json.loads(done.stdout)
    assert before == after
    compiled = {name.split(".")[2] for name, count in before.items() if count}
    assert compiled >= {"comfort", "episode", "geometry", "planner", "traffic"}
    assert (broken, results) == ([], 6 * 3)
