"""A followed campaign in notebooks, displayed again with each change."""

import sys
from collections.abc import Callable, Iterable, Iterator
from importlib import import_module
from typing import Any

from drivecal.contracts.campaign import Campaign


def displayed(states: Iterable[Campaign]) -> Iterator[Campaign]:
    """Yields the states of a campaign; in a notebook it displays each in place of the state before."""
    display = _display()
    shown: Any = None
    for campaign in states:
        if shown is not None:
            shown.update(campaign)
        elif display is not None:
            shown = display(campaign, display_id=True)
        yield campaign


def _display() -> Callable[..., Any] | None:
    """Returns IPython's `display` if this process serves a notebook, else None."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    if getattr(shell, "kernel", None) is None:
        return None
    display: Callable[..., Any] = import_module("IPython.display").display
    return display
