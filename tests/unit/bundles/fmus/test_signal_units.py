"""Units in FMUs of controllers must match the units of signals and commands."""

import re
from collections.abc import Callable

import pytest

from drivecal.bundles.fmus.checks import section_problems
from drivecal.bundles.fmus.description import Variables, parse_description
from drivecal.domain.errors import Problem

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


@pytest.fixture(params=VERSIONS)
def described(request: pytest.FixtureRequest) -> Callable[..., Variables]:
    """Returns the variables of an FMU that have these attributes; `unit`: that of the type."""
    whole, variable = VERSIONS[request.param]

    def write(unit: str = "m", **attributes: str) -> Variables:
        variables = "".join(variable.format(name, index, text) for index, (name, text) in enumerate(attributes.items()))
        return parse_description((whole % (UNITS, unit, variables)).encode()) or {}

    return write


def problems(variables: Variables) -> list[Problem]:
    section = {"signals": {"gap": "u1", "speed": "u2", "acceleration": "y"}, "output": ["acceleration"]}
    return list(section_problems("controller", section, variables, {}))


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
def test_variables_in_their_units_pass(described: Callable[..., Variables], gap: str, speed: str, acceleration: str) -> None:
    assert problems(described(u1=gap, u2=speed, y=acceleration)) == []


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
    described: Callable[..., Variables], attributes: dict[str, str], named: tuple[str, str, str]
) -> None:
    (problem,) = problems(described("ft", **({"u1": "", "u2": "", "y": ""} | attributes)))
    assert problem.field.startswith("controller.signals.")
    assert re.match(r"the variable {} is in {} .*, not in {}$".format(*named), problem.message)
