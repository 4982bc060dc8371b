"""Units in FMUs of controllers must match the units of signals and commands."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fmpy
import pytest

from drivecal.adapters.driver import UnusableError
from drivecal.adapters.fmu_driver import Fmu
from drivecal.bundles.fmus.description import parse_description
from drivecal.highway.drive import controllers
from drivecal.highway.drive.controllers import LoadedFmuController

UNITS = """<UnitDefinitions>
<Unit name="mps"><BaseUnit m="1" s="-1"/></Unit><Unit name="kmh"><BaseUnit m="1" s="-1" factor="0.2777777777777778"/></Unit>
</UnitDefinitions>"""
SECOND = """<fmiModelDescription fmiVersion="2.0" modelName="trial" guid="{trial}">
<CoSimulation modelIdentifier="trial"/>%s
<TypeDefinitions><SimpleType name="Typed"><Real unit="%s"/></SimpleType></TypeDefinitions>
<ModelVariables>%s</ModelVariables><ModelStructure/></fmiModelDescription>"""
THIRD = """<fmiModelDescription fmiVersion="3.0" modelName="trial" instantiationToken="{trial}">
<CoSimulation modelIdentifier="trial"/>%s
<TypeDefinitions><Float64Type name="Typed" unit="%s"/></TypeDefinitions>
<ModelVariables>%s</ModelVariables><ModelStructure/></fmiModelDescription>"""
VERSIONS = {
    "second": (SECOND, '<ScalarVariable name="{}" valueReference="{}"><Real {}/></ScalarVariable>'),
    "third": (THIRD, '<Float64 name="{}" valueReference="{}" {}/>'),
}


class Described(Fmu):
    """An FMU of a description alone, which cannot be run."""

    def __init__(self, file: Path, unpacked: Path) -> None:
        del unpacked
        self.model = fmpy.read_model_description(str(file), validate=False)
        self.variables = {variable.name: variable for variable in self.model.modelVariables}
        self.described = parse_description(file.read_bytes()) or {}
        self.is_third = self.model.fmiVersion.startswith("3")
        self._slave = SimpleNamespace(getReal=None, setReal=None, getFloat64=None, setFloat64=None)


@pytest.fixture(autouse=True)
def _described(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(controllers, "Fmu", Described)


@pytest.fixture(params=VERSIONS)
def described(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[..., Path]:
    """Writes the description of an FMU whose variables have these attributes; `unit`: that of the type."""
    whole, variable = VERSIONS[request.param]

    def write(unit: str = "m", **attributes: str) -> Path:
        file = tmp_path / "modelDescription.xml"
        variables = "".join(variable.format(name, index, text) for index, (name, text) in enumerate(attributes.items()))
        file.write_text(whole % (UNITS, unit, variables))
        return file

    return write


def controller(file: Path, units: dict[str, str] | None = None, **section: Any) -> LoadedFmuController:
    given = {"signals": {"gap": "u1", "speed": "u2", "acceleration": "y"}, "output": ["acceleration"]} | section
    return LoadedFmuController(file, file.parent, given, 0.1, units)


@pytest.mark.parametrize(
    ("gap", "speed", "acceleration"),
    [
        ("", "", ""),
        ('unit="m"', 'unit="m/s"', 'unit="m/s2"'),
        ('declaredType="Typed"', 'unit="m.s-1"', 'unit="m/s^2"'),
        ('unit="m"', 'unit="mps"', 'unit="m.s-2"'),
        ('unit=""', "", 'unit="m/(s.s)"'),
        ('unit="1"', 'unit="-"', 'unit="1"'),
    ],
)
def test_variables_in_their_units_pass(described: Callable[..., Path], gap: str, speed: str, acceleration: str) -> None:
    assert controller(described(u1=gap, u2=speed, y=acceleration))


@pytest.mark.parametrize(
    ("attributes", "named"),
    [
        ({"u2": 'unit="km/h"'}, ("u2", "km/h", "m/s")),
        ({"u2": 'unit="kmh"'}, ("u2", "kmh", "m/s")),
        ({"u1": 'declaredType="Typed"'}, ("u1", "ft", "m")),
        ({"y": 'unit="g"'}, ("y", "g", "m/s²")),
    ],
)
def test_a_variable_in_another_unit_is_refused_with_both_units(
    described: Callable[..., Path], attributes: dict[str, str], named: tuple[str, str, str]
) -> None:
    file = described("ft", **({"u1": "", "u2": "", "y": ""} | attributes))
    with pytest.raises(UnusableError, match=r"the variable {} is in {} .*, not in {};".format(*named)):
        controller(file)


@pytest.mark.parametrize("stated", ['unit="km/h"', 'declaredType="Typed"'])
def test_a_parameter_in_another_unit_is_refused_with_both_units(described: Callable[..., Path], stated: str) -> None:
    file = described("km/h", u1="", u2="", y="", v_set=stated)
    for unit in ("km/h", "1"):
        assert controller(file, {"v_set": unit})
    with pytest.raises(UnusableError, match=r"parameters\.v_set\.unit: .*km/h.*m/s"):
        controller(file, {"v_set": "m/s"})


def test_an_input_that_nothing_gives_is_refused_when_a_session_opens(described: Callable[..., Path]) -> None:
    file = described("m", u1="", u2="", y="", enable="")
    text = file.read_text()
    for written in ('<ScalarVariable name="enable"', '<Float64 name="enable"'):
        text = text.replace(written, f'{written} causality="input"')
    file.write_text(text)
    with pytest.raises(UnusableError, match=r"simulator\.controller\.constants: .*enable"):
        controller(file)
    assert controller(file, constants={"enable": 1.0})
    assert controller(file, {"enable": "1"})
    with pytest.raises(UnusableError, match=r"simulator\.controller\.constants\.enabled: .*enable"):
        controller(file, constants={"enable": 1.0, "enabled": 1.0})
