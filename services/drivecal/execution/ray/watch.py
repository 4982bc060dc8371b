"""Notices that a Ray cluster is gone: Ray itself says nothing for a minute, and then ends the process.

Ray's calls to workers just wait meanwhile, and so do we: what counts is whether the store of the cluster's state (GCS) answers. A store
that began anew knows nothing of what was before: whatever ran is gone.
"""

import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime

EVERY_SECONDS = 0.5
PATIENCE_SECONDS = 2.5
"""Without an answer, before it is said. A store that is only busy answers within milliseconds."""
GIVEN_UP_AFTER = 30.0
"""Seconds without an answer. Stores that keep their state can be away for that long, and everything goes on."""


class StartedAnewError(Exception):
    """The store does not know us any more."""


class ClusterWatch:
    """Asks again and again, in a thread of its own. `ask` returns soon, or raises: StartedAnewError where it need not be asked again."""

    def __init__(self, name: str, ask: Callable[[], None], clock: Callable[[], float] = time.monotonic) -> None:
        """`name`: what is asked, for messages."""
        self._name = name
        self._ask = ask
        self._clock = clock
        self._answered, self._answered_at = clock(), datetime.now(UTC)
        self._gone: str | None = None
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watch Ray", daemon=True)
        self._thread.start()

    def trouble(self) -> str | None:
        """Returns a message while it does not answer, else None."""
        if self._clock() - self._answered <= PATIENCE_SECONDS:
            return None
        return f"{self._name} has not answered since {self._answered_at:%H:%M:%S} UTC"

    def lost(self) -> str | None:
        """Why it does not come back, in words; None while there is hope."""
        return self._gone or (self.trouble() if self._clock() - self._answered > GIVEN_UP_AFTER else None)

    def answered_since(self, moment: float) -> bool:
        """Whether it answered after a moment (of the clock)."""
        return self._answered > moment

    def stop(self) -> None:
        """Asks no more. Nothing of Ray is used any more afterwards."""
        self._stopped.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stopped.wait(EVERY_SECONDS):
            try:
                self._ask()
            except StartedAnewError as error:
                self._gone = f"{self._name} {error}"
                return
            except Exception:  # noqa: BLE001, S112  # whatever Ray raises: no answer came, which is told by `trouble`
                continue
            self._answered, self._answered_at = self._clock(), datetime.now(UTC)
