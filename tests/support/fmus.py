"""FMUs that tests build: `x` grows by `rate * factor` per second, `runs` counts the runs of one process."""

import zipfile
from pathlib import Path

import fmpy
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from tests.support.simulators import compiled

HEADERS = Path(fmpy.__file__).parent / "c-code"

STATE = """
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
static double rate, x, now, size, end;
static int factor, flag, mode, runs, broken;
static char label[100];
static void defaults(void) { rate = 1; factor = 1; flag = 0; mode = 1; x = 0; now = 0; size = 0; broken = 0; strcpy(label, "none"); }
static int advance(double t, double h) {
    if (rate == 666) abort();
    if (rate == 777) exit(0);
    if (rate == 13) return 3;
    if (rate == 14) return 4;
    if (rate == 15) for (;;) { }
    if (rate == 16) { for (int i = 0; i < 2000; i++) puts("message"); fflush(stdout); }
    if (rate == 18 && ((size && h != size) || t + h > end)) return 3;
    size = h;
    x += (flag ? -1 : 1) * rate * factor * mode * h; now += h;
    return 0;
}
"""
"""Shared by both FMUs. Some rates misbehave: abort, exit, error, fatal, an endless loop, a flood, only steps of one size up to the end."""

SECOND = (
    STATE
    + r"""
#include "fmi2Functions.h"
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean l, size_t n, const fmi2String s[]) { return fmi2OK; }
fmi2Component fmi2Instantiate(fmi2String i, fmi2Type t, fmi2String g, fmi2String r, const fmi2CallbackFunctions *f, fmi2Boolean v,
    fmi2Boolean l) {
    static int instances;
    if (strcmp(g, "{trial}") || instances++) return NULL; /* once per process, as many FMUs */
    defaults(); return &x; }
void fmi2FreeInstance(fmi2Component c) { }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean d, fmi2Real t, fmi2Real s, fmi2Boolean e, fmi2Real z) {
    end = z; return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { runs++; return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { defaults(); return fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
    for (size_t i = 0; i < n; i++) v[i] = r[i] == 1 ? rate : r[i] == 2 ? x : now; return fmi2OK; }
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer v[]) {
    for (size_t i = 0; i < n; i++) v[i] = r[i] == 1 ? factor : r[i] == 2 ? mode : runs; return fmi2OK; }
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean v[]) { v[0] = flag; return fmi2OK; }
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String v[]) { v[0] = label; return fmi2OK; }
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) { rate = v[0]; return fmi2OK; }
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer v[]) {
    if (r[0] == 1) factor = v[0]; else mode = v[0]; return fmi2OK; }
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[]) { flag = v[0]; return fmi2OK; }
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String v[]) {
    snprintf(label, sizeof label, "%s", v[0]); return fmi2OK; }
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean f) { return (fmi2Status)advance(t, h); }
"""
)

THIRD = (
    STATE
    + r"""
#include "fmi3Functions.h"
const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Instance fmi3InstantiateCoSimulation(fmi3String i, fmi3String t, fmi3String p, fmi3Boolean v, fmi3Boolean l, fmi3Boolean e,
    fmi3Boolean a, const fmi3ValueReference q[], size_t n, fmi3InstanceEnvironment m, fmi3LogMessageCallback o,
    fmi3IntermediateUpdateCallback u) {
    defaults(); return &x; }
void fmi3FreeInstance(fmi3Instance c) { }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean d, fmi3Float64 t, fmi3Float64 s, fmi3Boolean e, fmi3Float64 z) {
    end = z; runs++; return fmi3OK; }
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3Reset(fmi3Instance c) { defaults(); return fmi3OK; }
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 v[], size_t m) {
    for (size_t i = 0; i < n; i++) v[i] = r[i] == 1 ? rate : r[i] == 2 ? x : now; return fmi3OK; }
fmi3Status fmi3GetInt32(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Int32 v[], size_t m) {
    for (size_t i = 0; i < n; i++) v[i] = r[i] == 11 ? factor : runs; return fmi3OK; }
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 v[], size_t m) {
    rate = v[0]; return fmi3OK; }
fmi3Status fmi3SetInt32(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Int32 v[], size_t m) {
    factor = v[0]; return fmi3OK; }
fmi3Status fmi3SetInt64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Int64 v[], size_t m) {
    mode = (int)v[0]; return fmi3OK; }
fmi3Status fmi3SetBoolean(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Boolean v[], size_t m) {
    flag = v[0]; return fmi3OK; }
fmi3Status fmi3SetString(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3String v[], size_t m) { return fmi3OK; }
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean f, fmi3Boolean *e, fmi3Boolean *s, fmi3Boolean *y,
    fmi3Float64 *l) {
    *e = 0; *s = rate == 17 && t > 0.5; *y = 0; *l = t + h; return (fmi3Status)advance(t, h); }
"""
)

SECOND_DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="trial" guid="{trial}">
  <CoSimulation modelIdentifier="trial" canHandleVariableCommunicationStepSize="true"/>
  <TypeDefinitions><SimpleType name="Mode"><Enumeration>
    <Item name="eco" value="1"/><Item name="sport" value="2"/></Enumeration></SimpleType>
  </TypeDefinitions>
  <ModelVariables>
    <ScalarVariable name="rate" valueReference="1" causality="parameter" variability="tunable"><Real start="1"/></ScalarVariable>
    <ScalarVariable name="factor" valueReference="1" causality="parameter" variability="fixed"><Integer start="1"/></ScalarVariable>
    <ScalarVariable name="flag" valueReference="1" causality="parameter" variability="fixed"><Boolean start="false"/></ScalarVariable>
    <ScalarVariable name="mode" valueReference="2" causality="parameter" variability="fixed"><Enumeration declaredType="Mode" start="1"/>
    </ScalarVariable>
    <ScalarVariable name="label" valueReference="1" causality="parameter" variability="fixed"><String start="none"/></ScalarVariable>
    <ScalarVariable name="body.x[1]" valueReference="2" causality="output" variability="continuous"><Real/></ScalarVariable>
    <ScalarVariable name="runs" valueReference="3" causality="output" variability="discrete"><Integer/></ScalarVariable>
  </ModelVariables>
  <ModelStructure/>
</fmiModelDescription>
"""

THIRD_DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="trial" instantiationToken="{trial}">
  <CoSimulation modelIdentifier="trial" canHandleVariableCommunicationStepSize="true"/>
  <TypeDefinitions><EnumerationType name="Mode">
    <Item name="eco" value="1"/><Item name="sport" value="2"/></EnumerationType></TypeDefinitions>
  <ModelVariables>
    <Float64 name="rate" valueReference="1" causality="parameter" variability="tunable" start="1"/>
    <Int32 name="factor" valueReference="11" causality="parameter" variability="fixed" start="1"/>
    <Boolean name="flag" valueReference="21" causality="parameter" variability="fixed" start="false"/>
    <Enumeration name="mode" valueReference="31" declaredType="Mode" causality="parameter" variability="fixed" start="1"/>
    <String name="label" valueReference="41" causality="parameter" variability="fixed"><Start value="none"/></String>
    <Float64 name="body.x[1]" valueReference="2" causality="output"/>
    <Int32 name="runs" valueReference="13" causality="output" variability="discrete"/>
  </ModelVariables>
  <ModelStructure/>
</fmiModelDescription>
"""


def build(folder: Path, version: int) -> Path:
    """Compiles an FMU of FMI 2 or 3; returns its file."""
    library = shared_library(folder, f"trial{version}", SECOND if version == 2 else THIRD, version)
    binary = f"binaries/{'linux64' if version == 2 else 'x86_64-linux'}/trial.so"
    return archive(folder / f"trial{version}.fmu", SECOND_DESCRIPTION if version == 2 else THIRD_DESCRIPTION, {binary: library})


def shared_library(folder: Path, name: str, text: str, version: int = 2) -> Path:
    """Compiles the functions of FMI that a text defines, and all others as failures."""
    source, rest = folder / f"{name}.c", folder / f"rest_of_{name}.c"
    source.write_text(text)
    # FMPy wants all functions to be there, unused ones included; they stand apart, because the headers declare their arguments
    names = [each for each in dir(FMU2Slave if version == 2 else FMU3Slave) if each.startswith(f"fmi{version}")]
    unused = [each for each in names if f" {each}(" not in text and f"*{each}(" not in text]
    rest.write_text("".join(f"int {each}(void) {{ return 3; }}\n" for each in unused))
    options = "-shared", "-fPIC", "-ffp-contract=off", f"-I{HEADERS}"
    return compiled("cc", source, folder / f"{name}.so", str(rest), *options)


def archive(file: Path, description: str, files: dict[str, Path]) -> Path:
    """Writes an FMU."""
    with zipfile.ZipFile(file, "w") as target:
        target.writestr("modelDescription.xml", description)
        for name, path in files.items():
            target.write(path, name)
    return file
