"""The account of a campaign as tables: by scenario, and the balance."""

from collections.abc import Iterator, Sequence

from drivecal.contracts.accounting import DEDUCTIONS, Accounting, ScenarioAccount

Row = Sequence[object]
FIELDS = tuple(ScenarioAccount.model_fields)


def by_scenario(account: Accounting) -> Iterator[Row]:
    """Yields a header, a row per scenario, and one for all of them."""
    yield FIELDS
    for scenario in account.scenarios:
        yield [getattr(scenario, field) for field in FIELDS]
    yield ["all", *(_total(account, field) for field in FIELDS[1:])]


def balance(account: Accounting) -> Iterator[Row]:
    """Yields a header and a row per item, in seconds of the workers (`Accounting.clock`): savings, costs, and the net."""
    yield "item", "value", "unit"
    for item, seconds in seconds_of(account):
        yield item, seconds, "s"
    if account.share_without_simulation is not None:
        yield "requested cells answered without simulation", account.share_without_simulation, "1"
    if account.break_even is not None:
        yield "break-even: requested cells", account.break_even.requested_cells, "1"
        yield "break-even: campaigns like this one", account.break_even.campaigns, "1"
        yield "break-even: reruns", account.break_even.reruns, "1"


def seconds_of(account: Accounting) -> list[tuple[str, float]]:
    """Returns the items that add up to the net, and further ones."""
    items = [
        *((f"saved by {outcome} cells", seconds) for outcome, seconds in account.savings.items()),
        *((f"cost of the {DEDUCTIONS.get(name, name)}", 0.0 - seconds) for name, seconds in account.deductions.items()),
        ("net", account.net_seconds),
        ("simulated", account.simulated_seconds),
        ("of these for audits", account.audited_seconds),
    ]
    if account.map_net_seconds is not None:
        items.append(("influence map alone: savings by reuse less its cost, whichever campaign paid", account.map_net_seconds))
    return items


def _total(account: Accounting, field: str) -> object:
    if field == "mean_seconds":
        priced = [
            (row.mean_seconds, row.simulated) for row in account.scenarios if row.mean_seconds is not None and row.simulated
        ]
        return sum(mean * runs for mean, runs in priced) / sum(runs for _, runs in priced) if priced else None
    return sum(getattr(scenario, field) for scenario in account.scenarios)
