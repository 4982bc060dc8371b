"""Messages of SUMO when it refuses files: in the exception, and on standard error, in case the process dies."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.support.changes import replace_in
from tests.support.motorways import NETWORK, ROUTE
from tests.unit.highway.drive.test_traffic import traffic

from drivecal.highway import sumo
from drivecal.highway.drive.traffic import TrafficError

DAMAGES: dict[str, tuple[Callable[[str], str], str, str]] = {
    "cut": (lambda text: text[: len(text) // 2], "unexpected end of input", "'road.net.xml'"),
    "node": (lambda text: text.replace('from="', 'from="zz', 1), "Unknown from-node", "edge 'e0'"),
    "state": (lambda text: text.replace(' state="M"', ' state="wrong"'), "link state", "'wrong'"),
    "empty": (lambda _: "", "invalid document structure", "'road.net.xml'"),
}
"""Damages of a network, and two of SUMO's words about each."""
ROUTE_FILES: dict[str, tuple[str, str, str]] = {
    "cut": ('<routes><vType id="a"', "whitespace expected", "'traffic.rou.xml'"),
    "edge": ('<routes><vehicle id="v" depart="0"><route edges="e0 e9"/></vehicle></routes>', "e9", "'v'"),
    "type": ('<routes><vType id="a" length="-3"/></routes>', "length", "greater than 0"),
    "acceleration": ('<routes><vType id="a" accel="-1"/></routes>', "VType", "accel"),
    "model": ('<routes><vType id="a" carFollowModel="Foo"/></routes>', "Foo", "'a'"),
}


def refusal(network: Path, routes: Path) -> str:
    """SUMO's exception."""
    with pytest.raises(sumo.SUMO_ERRORS) as error:
        sumo.load(sumo.options(str(network), str(routes), 0.1, 1))
    return str(error.value)


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_network_is_refused_in_the_words_of_sumo(damage: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    change, cause, place = DAMAGES[damage]
    network, routes = tmp_path / "road.net.xml", tmp_path / "traffic.rou.xml"
    network.write_text(change(NETWORK.read_text()))
    routes.write_text("<routes/>")
    said = refusal(network, routes)
    assert cause in said
    assert place in said
    assert str(tmp_path) not in said
    assert "\n" not in said
    assert cause in capfd.readouterr().err


@pytest.mark.parametrize("damage", ROUTE_FILES)
def test_routes_that_sumo_refuses_are_refused_in_its_words(damage: str, tmp_path: Path) -> None:
    text, cause, place = ROUTE_FILES[damage]
    routes = tmp_path / "traffic.rou.xml"
    routes.write_text(text)
    said = refusal(NETWORK, routes)
    assert cause in said
    assert place in said
    assert str(tmp_path) not in said


@pytest.mark.parametrize(("seconds", "loads"), [(1.0, 2), (40.0, 1)])
def test_a_slow_refusal_is_not_repeated(seconds: float, loads: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now, arguments = [0.0], []

    def refused(given: list[str]) -> None:
        arguments.append(given)
        now[0] += seconds
        raise sumo.SUMO_ERRORS[0](f"no lane in '{tmp_path}/traffic.rou.xml'")

    monkeypatch.setattr("libsumo.isLoaded", lambda: False)
    monkeypatch.setattr("libsumo.start", refused)
    replace_in(monkeypatch, sumo, "time", monotonic=lambda: now[0])
    said = refusal(NETWORK, tmp_path / "traffic.rou.xml")
    assert len(arguments) == loads
    assert "no lane in 'traffic.rou.xml'" in said
    assert ("40 s" in said) == (loads == 1)


def test_a_refused_network_leaves_standard_error_as_it_was(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    def described() -> tuple[int, int]:
        status = os.fstat(2)
        return status.st_dev, status.st_ino

    network = tmp_path / "road.net.xml"
    network.write_text(DAMAGES["state"][0](NETWORK.read_text()))
    before = described()
    refusal(network, tmp_path / "traffic.rou.xml")
    assert described() == before
    capfd.readouterr()
    os.write(2, b"later\n")
    assert capfd.readouterr().err == "later\n"


def test_what_others_write_while_sumo_s_errors_are_collected_is_passed_on(capfd: pytest.CaptureFixture[str]) -> None:
    said: list[str] = []
    with sumo._errors(said):
        os.write(2, b"Error: no such node\n In file '/tmp/x/road.net.xml'\nof another thread\nError: no such node\nError: b\n")
    assert said == ["no such node In file 'road.net.xml'", "no such node", "b"]
    written = capfd.readouterr().err
    assert "of another thread" in written
    assert "no such node" not in written


def test_a_scenario_is_refused_in_sumo_s_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = sumo.options

    def with_another_network(network: str, *rest: Any) -> list[str]:
        (tmp_path / "road.net.xml").write_text(DAMAGES["state"][0](Path(network).read_text()))
        return options(str(tmp_path / "road.net.xml"), *rest)

    monkeypatch.setattr(sumo, "options", with_another_network)
    with pytest.raises(TrafficError, match=r"scenarios\.s: .*road\.net\.xml.*link state 'wrong'"):
        traffic(NETWORK, ROUTE, tmp_path)
