"""Jobs: the work that the dispatcher does for a campaign's row."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

from drivecal.domain.campaigns import StageName
from drivecal.execution.scheduling.in_flight import Completed, RunBudget, Work


class Job(ABC):
    """Returns cells to simulate and takes their results until it is `finished`. The database holds all state after every call."""

    finished: bool = False
    stage: StageName | None = None
    """The running stage, for the log; None before the first, and for a job without stages."""
    goes_on: bool = False
    """True if work remains that needs no result."""
    asks_ahead: bool = False
    """True if `work` may return more cells while earlier cells are at workers."""
    awaited: str | None = None
    """Reason why nothing goes on until another program acts; None while it goes on."""
    write_seconds: float = 0.25
    """Least interval between transactions with results while cells are at workers: half of the time of small ones is fixed."""
    budget: RunBudget | None = None
    """Runs that the campaign may start, known after the first `work`; None without a limit."""

    @abstractmethod
    def work(self) -> list[Work]:
        """Returns what to simulate next; empty while answers are awaited, and when the job is `finished`."""

    @abstractmethod
    def record(self, completed: Sequence[Completed]) -> list[Work]:
        """Stores results; returns what to simulate in their place."""
