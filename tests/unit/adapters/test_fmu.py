"""Simulators of kind `fmu`: whole systems of FMI 2 and 3, built here."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import fmpy
import pytest
from tests.support.fmus import SECOND_DESCRIPTION, archive, build
from tests.support.simulators import hung, lost, opened

from drivecal.adapters import kinds
from drivecal.adapters.driver import UnusableError, blames_files
from drivecal.adapters.fmu_driver import Fmu, OutputStatistics, Writer
from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import Declared, UnsuitableError

MEASURES = {
    "end": "last(body.x[1])",
    "least": "min(body.x[1])",
    "most": "max( body.x[1] )",
    "usual": "mean(body.x[1])",
    "area": "integral(body.x[1])",
}
DECLARED = Declared("trial", tuple(MEASURES), series=("body.x[1]", "time"))
SECTION: dict[str, Any] = {"duration": 2.0, "step": 0.1, "measures": MEASURES}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fmus")
    build(path, 2)
    build(path, 3)
    return path


def run(folder: Path, file: str, declared: Declared = DECLARED, data: dict[str, Any] | None = None, **section: Any) -> Any:
    return opened("fmu", folder, declared, data=data or {}, **(SECTION | {"file": file} | section))


@pytest.mark.parametrize("file", ["trial2.fmu", "trial3.fmu"])
def test_measures_of_outputs(folder: Path, file: str) -> None:
    with run(folder, file) as session:
        for rate in (3.0, -1.0, 3.0):  # a reset forgets the run before
            measures = session.evaluate({"rate": rate}).measures
            expected = {"end": 2 * rate, "least": min(0, 2 * rate), "most": max(0, 2 * rate), "usual": rate, "area": 2 * rate}
            assert measures == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("file", ["trial2.fmu", "trial3.fmu"])
def test_start_values_of_all_types_come_from_data_and_parameters(folder: Path, file: str) -> None:
    label = "longer than a command line" * 10_000
    with run(folder, file, data={"rate": 5.0, "flag": True, "label": label}) as session:
        assert session.evaluate({}).measures["end"] == pytest.approx(-10)
        assert session.evaluate({"rate": 1.0, "factor": 3.0, "mode": "sport"}).measures["end"] == pytest.approx(-12)
        for wrong in (1.5, 2.0**31, -(2.0**31) - 1.0):
            assert "whole number from -2147483648 to 2147483647" in lost(session, {"factor": wrong}, Breakdown.ERROR)
        assert "it has eco, sport" in lost(session, {"mode": "fast"}, Breakdown.ERROR)
        assert "no variable rat, a parameter; it has e.g. rate" in lost(session, {"rat": 1.5}, Breakdown.ERROR)
        assert session.evaluate({}).measures["end"] == pytest.approx(-10)


@pytest.mark.parametrize("file", ["trial2.fmu", "trial3.fmu"])
def test_a_random_fmu_takes_the_seed_of_each_run(folder: Path, file: str) -> None:
    with run(folder, file, random=True, seed="factor") as session:
        ends = [session.evaluate({"rate": 1.0}, seed=seed).measures["end"] for seed in (1, 3, 1)]
    assert ends == pytest.approx([2.0, 6.0, 2.0])


@pytest.mark.slow("trial3.fmu")
@pytest.mark.parametrize("file", ["trial2.fmu", "trial3.fmu"])
def test_a_fault_costs_its_run_only(folder: Path, file: str) -> None:
    with run(folder, file) as session:
        for rate, breakdown, detail in (
            (666.0, Breakdown.CRASH, "SIGABRT"),
            (777.0, Breakdown.CRASH, "exit code 0"),
            (13.0, Breakdown.ERROR, "status 3 (error)"),
            (14.0, Breakdown.CRASH, "status 4 (fatal)"),
        ):
            assert detail in lost(session, {"rate": rate}, breakdown)
            assert session.evaluate({"rate": 1.0}).measures["end"] == pytest.approx(2)
        if file == "trial3.fmu":
            assert "ended the simulation" in lost(session, {"rate": 17.0}, Breakdown.ERROR)
        assert session.evaluate({"rate": 16.0}).measures["end"] == pytest.approx(32), "a flood of messages"
        hung(session, {"rate": 15.0}, 1.0)
        assert session.evaluate({"rate": 1.0}).measures["end"] == pytest.approx(2)


def test_the_last_step_may_be_shorter(folder: Path) -> None:
    with run(folder, "trial2.fmu", duration=1.0, step=0.3) as session:
        outcome = session.evaluate({"rate": 1.0}, series=True)
    assert outcome.measures["end"] == pytest.approx(1.0)
    assert outcome.series["time"] == pytest.approx([0, 0.3, 0.6, 0.9, 1.0])
    assert outcome.series["body.x[1]"] == pytest.approx([0, 0.3, 0.6, 0.9, 1.0])


@pytest.mark.parametrize(("duration", "step"), [(10.0, 0.01), (0.7, 0.1), (0.3, 0.1), (1.0, 1.0)])
def test_all_steps_have_one_size_and_end_at_the_stop_time(folder: Path, duration: float, step: float) -> None:
    with run(folder, "trial2.fmu" if step < 1 else "trial3.fmu", duration=duration, step=step) as session:
        assert session.evaluate({"rate": 18.0}).measures["end"] == pytest.approx(18.0 * duration)


def test_the_child_is_replaced_before_it_is_worn_out(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The FMU can be instantiated once per process; `runs` counts its runs."""
    monkeypatch.setattr(kinds, "MOST_FMU_RUNS", 3)
    with run(folder, "trial2.fmu", Declared("p", ("n",)), measures={"n": "last(runs)"}) as session:
        assert [session.evaluate({}).measures["n"] for _ in range(8)] == [1, 2, 3, 1, 2, 3, 1, 2]


def test_an_fmu_that_is_not_reset_has_a_process_for_each_run(folder: Path) -> None:
    with run(folder, "trial2.fmu", Declared("p", ("n",)), measures={"n": "last(runs)"}, reset=False) as session:
        assert [session.evaluate({}).measures["n"] for _ in range(3)] == [1, 1, 1]


FMI_1 = SECOND_DESCRIPTION.replace('fmiVersion="2.0"', 'fmiVersion="1.0"').replace("<CoSimulation", "<Nothing")
EXCHANGE = SECOND_DESCRIPTION.replace("CoSimulation", "ModelExchange")


@pytest.mark.parametrize(
    ("section", "detail"),
    [
        ({"measures": MEASURES | {"end": "last(body.y)"}}, r"no variable body\.y, a measured output; it has e\.g\. body\.x"),
        ({"measures": MEASURES | {"end": "last(label)"}}, "label is a text"),
        ({"file": "fmi1.fmu"}, "fmi1.fmu"),
        ({"file": "exchange.fmu"}, "co-simulation"),
        ({"file": "windows.fmu"}, "is built for win64, not for linux64"),
        ({"file": "empty.fmu"}, "modelDescription"),
        ({"file": "text.fmu"}, "modelDescription"),
        ({"file": "broken.fmu"}, "trial.so"),
        ({"file": "missing.fmu"}, "does not exist"),
    ],
)
def test_an_unusable_fmu_cannot_be_opened(folder: Path, tmp_path: Path, section: dict[str, Any], detail: str) -> None:
    (tmp_path / "trial2.fmu").symlink_to(folder / "trial2.fmu")
    (tmp_path / "text.fmu").write_text("no archive")
    (tmp_path / "library").write_text("no library")
    library = tmp_path / "library"
    archive(tmp_path / "fmi1.fmu", FMI_1, {"binaries/linux64/trial.so": library})
    archive(tmp_path / "exchange.fmu", EXCHANGE, {"binaries/linux64/trial.so": library})
    archive(tmp_path / "windows.fmu", SECOND_DESCRIPTION, {"binaries/win64/trial.dll": library})
    archive(tmp_path / "broken.fmu", SECOND_DESCRIPTION, {"binaries/linux64/trial.so": library})
    archive(tmp_path / "empty.fmu", "", {})
    with pytest.raises(UnavailableError, match=detail) as error, run(tmp_path, **({"file": "trial2.fmu"} | section)):
        pass
    may_run_elsewhere = section.get("file") in {"windows.fmu", "broken.fmu"}
    assert type(error.value) is (UnavailableError if may_run_elsewhere else UnsuitableError)


@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        (OSError("no file handles left"), OSError),
        (MemoryError(), MemoryError),
        (ImportError("no lxml"), ImportError),
        (KeyError("fmiVersion"), UnusableError),
    ],
)
def test_an_fmu_that_a_machine_cannot_read_is_not_blamed(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: Exception, kind: type[Exception]
) -> None:
    monkeypatch.setattr(fmpy, "read_model_description", Mock(side_effect=fault))
    with pytest.raises(kind) as error:
        Fmu(folder / "trial2.fmu", tmp_path / "unpacked")
    assert blames_files(error.value) is (kind is UnusableError)


def test_wrong_names_in_the_data_cannot_be_opened(folder: Path) -> None:
    with pytest.raises(UnavailableError, match=r"\bgap\b"), run(folder, "trial2.fmu", data={"gap": 1}):
        pass


def test_a_machine_without_fmpy_cannot_open_one(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kinds, "find_spec", lambda _: None)
    with pytest.raises(UnavailableError, match=r"drivecal\[fmu\]"), run(folder, "trial2.fmu"):
        pass


def test_a_value_that_is_no_number_spoils_its_statistics() -> None:
    statistics = OutputStatistics(1.0)
    for value in (2.0, float("nan"), 3.0):
        statistics.add(value, 0.5)
    assert str(statistics.min) == str(statistics.max) == str(statistics.mean) == "nan"


def test_a_whole_number_is_not_cut_from_another_without_a_description() -> None:
    fmu, written = Fmu.__new__(Fmu), list[object]()
    variable = SimpleNamespace(type="Integer", dimensions=[], valueReference=1)
    fmu.is_third, fmu.described, fmu.variables = False, {}, {"n": variable}
    fmu._slave = SimpleNamespace(setInteger=lambda _, values: written.extend(values))
    fmu._set("n", 2.0)
    with pytest.raises(UnusableError, match="n"):
        fmu._set("n", 2.7)
    assert written == [2]


def test_a_signal_that_its_variable_cannot_hold_is_refused_instead_of_wrapping() -> None:
    written: list[object] = []
    slave = SimpleNamespace(setInt8=lambda _, values: written.extend(values))
    writer = Writer(slave, {"Int8": [("a", 1), ("b", 2)]})
    writer.write([127.4, -128.0])
    with pytest.raises(UnusableError, match="b"):
        writer.write([0.0, 200.0])
    assert written == [127, -128]
