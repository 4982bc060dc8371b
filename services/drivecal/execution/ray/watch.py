"""Notices that a Ray cluster is gone: Ray itself reports nothing for a minute, and then ends the process.

Calls to workers just wait meanwhile, so the watch asks the store of the cluster's state (GCS). A restarted store has forgotten all actors.
"""

import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime

EVERY_SECONDS = 0.5
PATIENCE_SECONDS = 2.5
"""Silence before it is reported; a busy store answers within milliseconds."""
GIVEN_UP_AFTER = 30.0
"""Silence before the cluster is lost; a store that keeps its state may be away this long."""


class StartedAnewError(Exception):
    """The store has forgotten this process."""


class ClusterWatch:
    """Calls `ask` repeatedly in its own thread. `ask` returns soon or raises; StartedAnewError ends the watch."""

    def __init__(self, name: str, ask: Callable[[], None], clock: Callable[[], float] = time.monotonic) -> None:
        """`name`: name of the store in messages."""
        self._name = name
        self._ask = ask
        self._clock = clock
        self._answered, self._answered_at = clock(), datetime.now(UTC)
        self._gone: str | None = None
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watch Ray", daemon=True)
        self._thread.start()

    def trouble(self) -> str | None:
        """Returns a message during silence, else None."""
        if self._clock() - self._answered <= PATIENCE_SECONDS:
            return None
        return f"{self._name} has not answered since {self._answered_at:%H:%M:%S} UTC"

    def lost(self) -> str | None:
        """Returns the reason for a final loss, or None."""
        return self._gone or (self.trouble() if self._clock() - self._answered > GIVEN_UP_AFTER else None)

    def answered_since(self, moment: float) -> bool:
        """Returns whether the store answered after a moment of the clock."""
        return self._answered > moment

    def stop(self) -> None:
        """Ends the thread; Ray is unused afterwards."""
        self._stopped.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stopped.wait(EVERY_SECONDS):
            try:
                self._ask()
            except StartedAnewError as error:
                self._gone = f"{self._name} {error}"
                return
            except Exception:  # noqa: BLE001, S112  # any exception of Ray means no answer, which `trouble` reports
                continue
            self._answered, self._answered_at = self._clock(), datetime.now(UTC)
