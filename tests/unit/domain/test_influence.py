"""Influence maps."""

from __future__ import annotations

from decimal import Decimal

from drivecal.domain.influence import EVERYWHERE, Influence, InfluenceMap

KNOWN = Influence(influential=True, lower=Decimal("0.5"))


def test_a_map_knows_what_it_lists() -> None:
    assert InfluenceMap({"S1": {"P1": KNOWN}}).influence("S1", "P1") is KNOWN


def test_what_a_map_does_not_list_is_influential_everywhere() -> None:
    influences = InfluenceMap({"S1": {"P1": KNOWN}})
    assert influences.influence("S1", "P2") == EVERYWHERE
    assert influences.influence("S2", "P1") == EVERYWHERE
    assert EVERYWHERE.influential
    assert EVERYWHERE.lower is EVERYWHERE.upper is None
