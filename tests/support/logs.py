"""Lets a test configure the log, which belongs to the whole process."""

import logging
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import structlog


@contextmanager
def log_left_as_it_was() -> Iterator[None]:
    """Takes back everything that `drivecal.configuration.logs.configure` changes."""
    root, hooks = logging.getLogger(), (sys.excepthook, threading.excepthook)
    before = root.handlers, root.level
    levels = {name: logging.getLogger(name).level for name in ("drivecal", "__main__")}
    try:
        yield
    finally:
        root.handlers, root.level = before
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)
        sys.excepthook, threading.excepthook = hooks
        logging.captureWarnings(capture=False)
        structlog.reset_defaults()
        structlog.contextvars.clear_contextvars()
