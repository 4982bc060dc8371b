"""The account of a campaign as tables: by scenario, and the balance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from drivecal.contracts.accounting import Accounting, ScenarioAccount

Row = Sequence[object]
FIELDS = tuple(ScenarioAccount.model_fields)


def by_scenario(found: Accounting) -> Iterator[Row]:
    """A header, a row per scenario, and one for all of them."""
    yield FIELDS
    for scenario in found.scenarios:
        yield [getattr(scenario, field) for field in FIELDS]
    yield ["all", *(_total(found, field) for field in FIELDS[1:])]


def balance(found: Accounting) -> Iterator[Row]:
    """A header and a row per item, in CPU seconds of the workers: what was saved, what it cost, what is left."""
    yield "item", "value", "unit"
    for item, seconds in seconds_of(found):
        yield item, seconds, "s"
    if found.share_without_simulation is not None:
        yield "requested cells answered without simulation", found.share_without_simulation, "1"
    if found.break_even is not None:
        yield "break-even: requested cells", found.break_even.requested_cells, "1"
        yield "break-even: campaigns like this one", found.break_even.campaigns, "1"
        yield "break-even: reruns", found.break_even.reruns, "1"


def seconds_of(found: Accounting) -> list[tuple[str, float]]:
    """The items that add up to the net, and what stands beside it."""
    items = [
        ("saved by repeated cells", found.repeated_saved_seconds),
        ("saved by reused cells", found.reused_saved_seconds),
        ("saved by certified cells", found.certified_saved_seconds),
        ("cost of the sensitivity stage", 0.0 - found.sensitivity.seconds),
        ("net", found.net_seconds),
        ("simulated", found.simulated_seconds),
        ("of these for audits", found.audited_seconds),
    ]
    if found.map_net_seconds is not None:
        items.append(("the influence map alone: reused less its cost, whoever paid", found.map_net_seconds))
    return items


def _total(found: Accounting, field: str) -> object:
    if field == "mean_seconds":
        return found.simulated_seconds / found.simulated if found.simulated else None
    return sum(getattr(scenario, field) for scenario in found.scenarios)
