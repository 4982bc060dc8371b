"""Setup and cells for the driving functions in `plugins`, as a coordinator that has them installed would send them."""

from pathlib import Path

from tests.support.plugins.misbehaving import MISBEHAVING
from tests.support.setups import driven

from drivecal.bundles.installed import installed_problems
from drivecal.contracts.work import SetupRequest
from drivecal.plugins.ports import DrivingFunction

FOLDER = Path(__file__).parent / "plugins"
ARCHIVES = {problem.digest: problem.archive for problem in installed_problems().values()}
"""Problem bundles that the real backends of the tests know, by digest."""


def misbehaving_setup(scenario: str = "S1", function: DrivingFunction = MISBEHAVING) -> SetupRequest:
    return driven(scenario, function=function)
