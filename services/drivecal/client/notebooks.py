"""Answers in notebooks: lists of rows as tables, and a followed campaign that is displayed anew with each change."""

import sys
from collections.abc import Callable, Iterable, Iterator
from importlib import import_module
from typing import Any, TypeVar

from pydantic import BaseModel

from drivecal.contracts.campaign import Campaign, html_table

RowModel = TypeVar("RowModel", bound=BaseModel)


class Rows(list[RowModel]):
    """Rows of a table: a list that notebooks show as a table."""

    def _repr_html_(self) -> str:
        """Returns the first rows as a table."""
        return html_table([row.model_dump(mode="json") for row in self])


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
