"""Simulators of kind `python`: a function in a file of the bundle."""

import platform
import sys
import zipfile
from pathlib import Path

import pytest
from tests.support.simulators import lost, opened

from drivecal.adapters.python_driver import answer, fits
from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import Declared, UnsuitableError


def write(folder: Path, body: str, head: str = "") -> None:
    (folder / "model.py").write_text(
        f"import os, sys\n{head}\ndef evaluate(parameters, scenario):\n    x = parameters['x']\n    {body}\n"
    )


def test_a_function_gets_parameters_and_scenario(tmp_path: Path) -> None:
    write(tmp_path, "return {'y': x * scenario['k']}")
    with opened("python", tmp_path, file="model.py") as session:
        assert session.evaluate({"x": 2.0}).measures == {"y": 6.0}
        assert session.evaluate({"x": 3.0}).measures == {"y": 9.0}


def test_sets_have_one_order_in_every_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path, "return {'y': hash('text') % 1_000_000}")
    measured = set()
    for secret in ("5", "random"):
        monkeypatch.setenv("PYTHONHASHSEED", secret)
        with opened("python", tmp_path, file="model.py") as session:
            measured.add(session.evaluate({"x": 2.0}).measures["y"])
    assert len(measured) == 1


def test_no_variable_brings_modules_into_a_driver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sitecustomize.py").write_text("import sys; sys.customized = True")
    write(tmp_path, "return {'y': float(hasattr(sys, 'customized'))}")
    for places in (":", str(tmp_path)):
        monkeypatch.setenv("PYTHONPATH", places)
        with opened("python", tmp_path, file="model.py", environment=["PYTHONPATH"]) as session:
            assert session.evaluate({"x": 2.0}).measures == {"y": 0.0}


def test_the_scenario_of_a_random_function_has_the_seed(tmp_path: Path) -> None:
    write(tmp_path, "return {'y': x + 10 * scenario.get('seed', 0)}")
    for is_random, measured in ((True, [12.0, 42.0]), (False, [2.0, 2.0])):
        with opened("python", tmp_path, file="model.py", random=is_random) as session:
            assert [session.evaluate({"x": 2.0}, seed=seed).measures["y"] for seed in (1, 4)] == measured


def test_the_function_and_the_file_may_have_other_names(tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "helper.py").write_text("FACTOR = 5")
    (tmp_path / "models" / "json.py").write_text("from helper import FACTOR\ndef run(p, s): return {'y': FACTOR * p['x']}")
    with opened("python", tmp_path, file="models/json.py", function="run") as session:
        assert session.evaluate({"x": 2.0}).measures == {"y": 10.0}
    assert not list(tmp_path.rglob("__pycache__"))


def test_what_a_function_prints_and_reads_disturbs_nothing(tmp_path: Path) -> None:
    body = (
        "print('{}'); sys.stdout.flush(); os.write(1, b'x\\n'); os.system('echo shell; cat'); sys.__stdout__.write('y\\n')"
        "\n    return {'y': float(sys.stdin.read() == '')}"
    )
    write(tmp_path, body)
    with opened("python", tmp_path, file="model.py") as session:
        for _ in range(3):
            assert session.evaluate({"x": 2.0}).measures == {"y": 1.0}


@pytest.mark.parametrize(
    ("body", "breakdown", "detail"),
    [
        ("1 / 0", Breakdown.ERROR, "ZeroDivisionError: division by zero (model.py:6)"),
        ("sys.exit('stop')", Breakdown.ERROR, "stop"),
        ("if os.fork(): 1 / 0\n        sys.exit()", Breakdown.ERROR, "ZeroDivisionError"),
        ("os._exit(3)", Breakdown.CRASH, "exit code 3"),
        ("import ctypes; ctypes.string_at(0)", Breakdown.CRASH, "SIGSEGV"),
        ("bytearray(8_000_000_000)", Breakdown.MEMORY, "MemoryError"),
        ("return None", Breakdown.ERROR, "returned NoneType"),
        ("return {'y': object()}", Breakdown.ERROR, "not JSON serializable"),
        ("import numpy; return {'y': numpy.complex128(3 + 4j)}", Breakdown.ERROR, "not JSON serializable"),
        ("import numpy; return {'y': numpy.True_}", Breakdown.ERROR, "not JSON serializable"),
        ("raise type('Odd', (Exception,), {'__str__': lambda self: 1})()", Breakdown.ERROR, "Odd"),
        ("return parameters['q']", Breakdown.ERROR, "KeyError: 'q'"),
    ],
)
def test_a_fault_costs_its_run_only(tmp_path: Path, body: str, breakdown: Breakdown, detail: str) -> None:
    write(tmp_path, f"if x == 1.0:\n        {body}\n    return {{'y': x}}")
    with opened("python", tmp_path, file="model.py") as session:
        assert detail in lost(session, {"x": 1.0}, breakdown)
        assert session.evaluate({"x": 2.0}).measures == {"y": 2.0}


def test_a_function_may_report_failures_and_series(tmp_path: Path) -> None:
    write(tmp_path, "return {'measures': {'y': 1}, 'series': {'t': [0, 1]}} if x else {'failure': 'collision'}")
    with opened("python", tmp_path, file="model.py") as session:
        assert session.evaluate({"x": 1.0}, series=True).series == {"t": [0.0, 1.0]}
        assert session.evaluate({"x": 0.0}).failure == "collision"


def test_a_measure_may_be_called_failure() -> None:
    assert answer({"failure": 0.5}) == {"measures": {"failure": 0.5}}


def test_a_failure_may_stand_among_the_measures() -> None:
    flat = {"y": 2.5, "failure": "collision", "place": "exit"}
    assert answer(flat) == flat | {"measures": {"y": 2.5}}


def test_numbers_of_numpy_are_numbers(tmp_path: Path) -> None:
    write(tmp_path, "return {'y': numpy.float32(x) * numpy.int64(2)}", "import numpy")
    with opened("python", tmp_path, file="model.py") as session:
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}


@pytest.mark.parametrize(
    ("head", "detail", "kind"),
    [
        ("import nothing_like_it", "nothing_like_it", UnavailableError),  # another machine may have it
        ("def broken(", "SyntaxError", UnsuitableError),
        ("del sys.modules['os'].environ\nevaluate2 = 1\nraise OSError('x')", "OSError", UnavailableError),
    ],
)
def test_a_file_that_cannot_be_imported_cannot_be_opened(tmp_path: Path, head: str, detail: str, kind: type[Exception]) -> None:
    write(tmp_path, "return {}", head)
    with pytest.raises(UnavailableError, match=detail) as error, opened("python", tmp_path, file="model.py"):
        pass
    assert type(error.value) is kind


def test_a_missing_function_or_file_cannot_be_opened(tmp_path: Path) -> None:
    write(tmp_path, "return {}")
    with pytest.raises(UnsuitableError, match=r"\brun\b"), opened("python", tmp_path, file="model.py", function="run"):
        pass
    with pytest.raises(UnavailableError, match=r"other\.py"), opened("python", tmp_path, file="other.py"):
        pass
    with pytest.raises(UnavailableError, match="wheels"), opened("python", tmp_path, file="model.py", wheels="wheels"):
        pass


def wheel(folder: Path, name: str, text: str) -> None:
    folder.mkdir(exist_ok=True)
    with zipfile.ZipFile(folder / name, "w") as archive:
        archive.writestr("own_package/__init__.py", text)


def test_wheels_of_the_bundle_come_first(tmp_path: Path) -> None:
    wheel(tmp_path / "wheels", "own_package-1.0-py3-none-any.whl", "FACTOR = 7")
    wheel(tmp_path / "wheels", "own_package-1.0-cp27-cp27m-win32.whl", "raise ImportError")
    write(tmp_path, "if x == 1.0: os.abort()\n    return {'y': x * own_package.FACTOR}", "import own_package")
    with opened("python", tmp_path, file="model.py", wheels="wheels") as session:
        assert session.evaluate({"x": 2.0}).measures == {"y": 14.0}
        lost(session, {"x": 1.0}, Breakdown.CRASH)
        assert session.evaluate({"x": 3.0}).measures == {"y": 21.0}


def test_a_broken_wheel_cannot_be_opened(tmp_path: Path) -> None:
    (tmp_path / "wheels").mkdir()
    (tmp_path / "wheels" / "own-1.0-py3-none-any.whl").write_text("no archive")
    write(tmp_path, "return {}")
    with (
        pytest.raises(UnavailableError, match="BadZipFile"),
        opened("python", tmp_path, Declared("p", ("y",)), file="model.py", wheels="wheels"),
    ):
        pass


def test_wheels_are_chosen_by_their_tags() -> None:
    own = f"cp{sys.version_info.major}{sys.version_info.minor}"
    assert fits("a-1-py3-none-any.whl")
    assert fits("a-1-1build-py2.py3-none-any.whl")
    assert fits(f"a-1-{own}-{own}-manylinux_2_17_x86_64.manylinux2014_x86_64.whl") or sys.platform != "linux"
    assert fits("a-1-cp38-abi3-linux_x86_64.whl")
    for other in (
        "a-1-cp99-cp99-linux_x86_64.whl",
        f"a-1-{own}-{own}-win_amd64.whl",
        f"a-1-{own}-{own}-musllinux_1_2_{platform.machine()}.whl",
        f"a-1-{own}-{own}-manylinux_2_99_{platform.machine()}.whl",
        "a-1-cp99-abi3-linux_x86_64.whl",
        "a-1-py2-none-any.whl",
    ):
        assert not fits(other)
