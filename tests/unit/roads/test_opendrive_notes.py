"""Notes on OpenDRIVE files, and lanes that have no place in them."""

import re
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from tests.support.opendrive_files import FILES, edited

from drivecal.bundles.traffic.elements import Notes as Tree
from drivecal.bundles.traffic.elements import read_tree
from drivecal.domain.errors import InvalidInputError
from drivecal.roads import conversion
from drivecal.roads.conversion import converted
from drivecal.roads.corridor import corridor
from drivecal.roads.documents import JoinedNotes, cut
from drivecal.roads.network import read_network
from drivecal.roads.opendrive import read_opendrive

NAME = "road.xodr"


def netconvert_writes(monkeypatch: pytest.MonkeyPatch, change: Callable[[bytes], bytes], said: str = "") -> None:
    run = conversion.run_netconvert

    def changed(arguments: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str]:
        process, file = run(arguments, folder), folder / "road.net.xml"
        network = file.read_bytes()
        file.write_bytes(change(network))
        assert said or file.read_bytes() != network
        return subprocess.CompletedProcess(process.args, process.returncode, process.stdout + said, process.stderr)

    monkeypatch.setattr(conversion, "run_netconvert", changed)


def test_equal_notes_are_one_with_the_first_places_and_how_many_more() -> None:
    notes = JoinedNotes()
    for number in range(12):
        notes.add(f"road {number}", "no width")
        notes.add("road 0", "no width")
    notes.add("road 7", "no limit")
    assert notes.texts() == ["road 0; road 1; road 2; road 3; road 4 and 7 more: no width", "road 7: no limit"]


def test_the_last_note_counts_those_that_are_left_out() -> None:
    assert cut([str(number) for number in range(50)]) == tuple(str(number) for number in range(50))
    assert cut([str(number) for number in range(60)])[50:] == ("and 10 more notes",)
    elements = "".join(f"<e{number}/>" for number in range(53))
    notes = Tree("a.xosc").texts(read_tree(f"<OpenSCENARIO>{elements}</OpenSCENARIO>".encode(), "a.xosc", "OpenSCENARIO"))
    assert notes[50:] == ("a.xosc: and 3 more notes",)


def test_warnings_of_netconvert_that_differ_in_names_are_one(monkeypatch: pytest.MonkeyPatch) -> None:
    warnings = "".join(f"Warning: Edge '{number}' has no lanes.\n" for number in range(60))
    netconvert_writes(monkeypatch, lambda network: network, warnings)
    assert "netconvert: Edge '0' has no lanes. (and 59 like it)" in converted(FILES["two_way"](), NAME).notes


def test_elements_that_nothing_reads_are_noted_by_tag_once_with_all_that_they_hold() -> None:
    inside = "<vectorLane><speed max='9'/></vectorLane>"
    content = edited("two_way", "</lanes>", f"</lanes><userData>{inside}</userData><surface><CRG/></surface><userData/>")
    assert read_opendrive(content, NAME).ignored == {
        **read_opendrive(FILES["two_way"](), NAME).ignored,
        "userData": 2,
        "surface": 1,
    }
    assert {"2 x userData: ignored", "1 x surface: ignored"} <= set(converted(content, NAME).notes)


@pytest.mark.parametrize("around", ["OpenDRIVE", "road", "junction", "planView", "lanes", "lane", "link"])
def test_what_stands_in_an_element_that_nothing_reads_has_no_effect(around: str) -> None:
    geometries = "<planView><geometry s='0' x='0' y='0' hdg='0' length='1'><line/></geometry><geometry/></planView>"
    roads = "<road/><lane id='-1'/><link><predecessor id='x'/></link><type><speed/></type><connection/>"
    content = edited("entrance", f"(<{around}(?: [^>]*[^/])?>)", rf"\1<boundary>{geometries}{roads}</boundary>", count=0)
    assert read_opendrive(content, NAME).roads == read_opendrive(FILES["entrance"](), NAME).roads


def test_a_lane_that_is_not_in_the_file_is_noted_and_no_route_leads_over_it(monkeypatch: pytest.MonkeyPatch) -> None:
    lane = re.compile(rb'(<lane id="-5#1_1".*?key="origId" value=)"5_-2"', re.DOTALL)
    netconvert_writes(monkeypatch, lambda network: lane.sub(rb'\1"9_-2"', network, count=1))
    result = converted(FILES["two_way"](), NAME)
    (note,) = [note for note in result.notes if note.startswith("edge -5#1, lane 1")]
    assert "9_-2" in note
    network = read_network(result.network, NAME)
    with pytest.raises(InvalidInputError) as error:
        corridor(network, ["-5#0", "-5#1", "-5#2"], NAME)
    (problem,) = error.value.problems
    assert (problem.field, bool(problem.remedy)) == ("route[1]", True)  # the way to the lane is not there, either
    with pytest.raises(InvalidInputError, match="9_-2"):
        corridor(network, ["-5#1"], NAME)
    assert corridor(network, ["5#1", "5#0"], NAME).length > 10.0


def test_a_missing_way_through_a_junction_is_noted_and_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """netconvert names a lane of the connecting road that is not there: its own arc would be driven."""
    netconvert_writes(monkeypatch, lambda network: network.replace(b'value="10_-1"', b'value="10_-7"'))
    result = converted(FILES["entrance"](), NAME)
    assert any(note.startswith("junction between -1_") and "10_-7" in note for note in result.notes)
    with pytest.raises(InvalidInputError) as error:
        corridor(read_network(result.network, NAME), ["-1", "-2#0"], NAME)
    assert [problem.field for problem in error.value.problems] == ["route[1]"]
