"""A worker as a Ray actor: it shows signs of life in Ray's state store, which answers while all workers are busy."""

import itertools
import threading
import time
from contextlib import suppress
from importlib import import_module
from typing import Any

from drivecal.cluster.pulse import EVERY_SECONDS
from drivecal.runtime.worker import Worker

WRITING_SECONDS = 2.0
"""Time limit for a sign."""


class RayWorker(Worker):
    """A worker. A thread counts up the value of `key` every second."""

    def __init__(self, name: str, key: bytes) -> None:
        super().__init__(name)
        threading.Thread(target=_show, args=(key,), name="pulse", daemon=True).start()


def _show(key: bytes) -> None:
    ray: Any = import_module("ray._private.worker")  # no public interface
    for number in itertools.count():
        with suppress(Exception):  # the store is away: the next sign may arrive
            ray.global_worker.gcs_client.internal_kv_put(key, b"%d" % number, True, None, timeout=WRITING_SECONDS)
        time.sleep(EVERY_SECONDS)
