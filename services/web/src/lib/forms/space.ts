/** Scenarios and parameters of a campaign as a form shows them: read from the specification, and written into it only where they differ from the problem's own. */

import { baseOf } from "../front/weights";
import type { SetSide } from "../server/cells";
import type { Shape, ShapeParameter } from "../server/shape";
import type { Campaign } from "../server/types";
import { changed } from "./schema";

export type Wanted = Readonly<Record<string, unknown>>;
export type Value = number | string;

export interface ParameterRow {
  parameter: ShapeParameter;
  lower: number | undefined;
  upper: number | undefined;
  step: number | undefined;
  choices: readonly string[];
  fixed: Value | undefined;
  baseline: Value | undefined;
}

export interface ScenarioRow {
  id: string;
  title: string;
  used: boolean;
  weight: number;
}

type Range = Pick<ParameterRow, "lower" | "upper" | "step" | "choices">;

function mapOf(value: unknown): Record<string, Value> {
  return typeof value === "object" && value !== null && !Array.isArray(value) ? (value as Record<string, Value>) : {};
}

function ownRange({ lower, upper, step, choices }: ShapeParameter): Range {
  return { lower, upper, step: step ?? undefined, choices };
}

type Entry = Readonly<Record<string, unknown>>;

/** The specification's entry of a parameter: its own, or that of the curve whose coefficient it is. */
function listedAs(shape: Shape, wanted: Wanted, name: string): Entry | undefined {
  const listed = Array.isArray(wanted["parameters"]) ? (wanted["parameters"] as Entry[]) : [];
  return listed.find((entry) => entry["name"] === name) ?? listed.find((entry) => entry["name"] === shape.curves[name]);
}

export function parameterRows(shape: Shape, wanted: Wanted): ParameterRow[] {
  const fixed = mapOf(wanted["fixed"]);
  const baseline = mapOf(wanted["baseline"] ?? shape.baseline);
  return shape.parameters.map((parameter) => {
    const entry = listedAs(shape, wanted, parameter.name);
    const known = (name: string): number | undefined => (typeof entry?.[name] === "number" ? entry[name] : undefined);
    const range = entry ? { lower: known("lower"), upper: known("upper"), step: known("step"), choices: (entry["choices"] as string[] | undefined) ?? parameter.choices } : ownRange(parameter);
    return { parameter, ...range, fixed: fixed[parameter.name], baseline: baseline[parameter.name] };
  });
}

/** The specification with another range of a parameter. All parameters are listed as soon as one of them differs. */
export function withRange(shape: Shape, wanted: Wanted, name: string, changes: Partial<Range>): Wanted {
  const rows = parameterRows(shape, wanted).map((row) => (row.parameter.name === name ? { ...row, ...changes } : row));
  const same = ({ parameter, lower, upper, step, choices }: ParameterRow): boolean =>
    JSON.stringify(ownRange(parameter)) === JSON.stringify({ lower, upper, step, choices: choices.length > 0 ? choices : parameter.choices }) || (parameter.kind === "choice" && choices.length === parameter.choices.length);
  const entries = rows.map((row) => {
    const entry = listedAs(shape, wanted, row.parameter.name);
    // An entry of a curve stands for all its coefficients, until one of them is changed.
    return entry !== undefined && entry["name"] !== row.parameter.name && shape.curves[name] !== entry["name"] ? entry : entryOf(row, entry?.["integer"] === true);
  });
  return changed(wanted, "parameters", rows.every(same) ? undefined : [...new Set(entries)]);
}

function entryOf({ parameter: { name, kind, unit }, lower, upper, step, choices }: ParameterRow, integer: boolean): Entry {
  if (kind === "choice") return { name, choices, unit };
  return { name, lower, upper, ...(kind === "integer" || integer ? { integer: true } : step === undefined ? {} : { step }), unit };
}

export function withFixed(wanted: Wanted, name: string, value: Value | undefined): Wanted {
  return changed(wanted, "fixed", filled(mapOf(wanted["fixed"]), name, value));
}

/** The specification with another value of the baseline; the problem keeps the other values. */
export function withBaseline(shape: Shape, wanted: Wanted, name: string, value: Value | undefined): Wanted {
  const baseline = filled(mapOf(wanted["baseline"] ?? shape.baseline), name, value);
  return changed(wanted, "baseline", JSON.stringify(baseline) === JSON.stringify(shape.baseline ?? undefined) ? undefined : baseline);
}

/** A whole baseline; empty: none of its own. */
export function withBaselineOf(wanted: Wanted, values: Readonly<Record<string, Value>>): Wanted {
  return changed(wanted, "baseline", Object.keys(values).length > 0 ? values : undefined);
}

/** Name, sign and value: `P1=0.5`, `"P1": 0.5,`, or the cells of a table. */
const PAIR = /^\s*"?([^"=:,\s]+)"?\s*([=:,\t ])\s*"?(.*?)"?\s*,?\s*$/;
/** Between pairs; a comma within a value is none. */
const BETWEEN = /[\n;{}]|,(?=\s*"?[A-Za-z][\w.-]*"?\s*[=:])/;

/** A set as people write it: `P1=0.5` in lines or between commas, the first two columns of a table, or JSON. `faults` name what the problem does not have, and why. */
export function pastedSet(text: string, parameters: readonly ShapeParameter[]): { values: Record<string, Value>; faults: string[] } {
  const [values, faults]: [Record<string, Value>, string[]] = [{}, []];
  for (const part of text.split(BETWEEN)) {
    const pair = PAIR.exec(part);
    const [, name = "", sign = "", rest = ""] = pair ?? [];
    // A line of a table goes on, with the unit for example.
    const written = sign === "," || sign === "\t" ? (rest.split(sign)[0] ?? "").trim() : rest;
    if (part.trim() === "" || (name === "parameter" && written === "value")) continue;
    const parameter = parameters.find((entry) => entry.name === name);
    if (!parameter) faults.push(pair ? `${name} is no parameter` : `${part.trim()} is not NAME=VALUE`);
    else if (parameter.kind === "choice") {
      if (parameter.choices.includes(written)) values[name] = written;
      else faults.push(`${name} is one of ${parameter.choices.join(", ")}`);
    } else if (written === "" || Number.isNaN(Number(written))) faults.push(`${name} is a number, not ${written || "empty"}`);
    else values[name] = Number(written);
  }
  return { values, faults: [...new Set(faults)] };
}

export function scenarioRows(shape: Shape, wanted: Wanted): ScenarioRow[] {
  const listed = Array.isArray(wanted["catalogue"]) ? (wanted["catalogue"] as string[]) : null;
  const weights = mapOf(wanted["weights"]);
  return shape.scenarios.map(({ id, title }) => ({ id, title, used: listed?.includes(id) ?? true, weight: Number(weights[id] ?? 1) }));
}

/** The specification with a scenario more or less; the last one stays. */
export function withScenario(shape: Shape, wanted: Wanted, id: string, used: boolean): Wanted {
  const rows = scenarioRows(shape, wanted).map((row) => (row.id === id ? { ...row, used } : row));
  const left = rows.filter((row) => row.used).map((row) => row.id);
  if (left.length === 0) return wanted;
  const catalogue = typeof wanted["catalogue"] === "string" ? wanted["catalogue"] : undefined;
  const listed = changed(wanted, "catalogue", left.length === rows.length ? catalogue : left);
  return used ? listed : withWeight(listed, id, 1);
}

export function withWeight(wanted: Wanted, id: string, weight: number): Wanted {
  return changed(wanted, "weights", filled(mapOf(wanted["weights"]), id, weight === 1 ? undefined : weight));
}

/** The specification of a clone. `analysed`: with an analysis, if the campaign has none; the default of reuse follows it then. `start`: the sets that its search starts with, if it is a list; its budget is twice as large then, as the outlook of results supposes. */
export function cloneOf({ name, kind, spec, budget = null }: Pick<Campaign, "name" | "kind" | "spec"> & Partial<Pick<Campaign, "budget">>, analysed: boolean, start?: unknown): Wanted {
  const begins = Array.isArray(start);
  // Settings of single evaluations and of studies that a search with their sets does not have.
  const left = !begins || spec.optimizer ? [] : kind === "evaluation" ? ["parameters", "scenario", "seeds", "fresh"] : ["robustness", "validation"];
  const kept = Object.fromEntries(Object.entries(spec).filter(([field]) => !left.includes(field)));
  const clone: Wanted = { ...kept, ...(begins ? { optimizer: { ...spec.optimizer, start_sets: start } } : {}), ...(begins && budget?.simulations ? { budget: { ...budget, simulations: 2 * budget.simulations } } : {}), name: `${name.slice(0, 190)} again` };
  if (!analysed || (spec.sensitivity ?? null) !== null) return clone;
  return { ...clone, sensitivity: {}, ...(spec.reduction?.mode === "predicted" ? { reduction: changed(spec.reduction, "mode", undefined) } : {}) };
}

/** The single evaluation that simulates a set of a campaign again; null if its scenarios are of several variants: each has its own vehicle. */
export function checkOf({ spec }: Pick<Campaign, "spec">, { parameters, scores }: Pick<SetSide, "parameters" | "scores">, seeds: readonly number[]): Wanted | null {
  const [variant, ...others] = new Set(Object.keys(scores).map((scenario) => scenario.split("@")[1]));
  const [scenario, ...more] = Object.keys(scores).map(baseOf);
  if (others.length > 0) return null;
  const { problem, catalogue, driving_function, vehicle, evaluator, variants } = spec;
  const driven = variant === undefined ? vehicle : { ...vehicle, parameters: { ...vehicle?.parameters, ...variants?.[variant]?.vehicle?.parameters } };
  return { problem, catalogue, driving_function, vehicle: driven, evaluator, parameters, fresh: true, ...(seeds.length > 0 ? { seeds } : {}), ...(more.length === 0 ? { scenario } : {}) };
}

/** The parts of a specification that belong to a problem: another one begins without them. */
const OF_A_PROBLEM = ["catalogue", "parameters", "fixed", "baseline", "weights", "evaluator", "driving_function", "vehicle", "variants", "objectives", "constraints", "robustness"];

export function withProblem(wanted: Wanted, problem: string | undefined): Wanted {
  const left = Object.fromEntries(Object.entries(wanted).filter(([name]) => !OF_A_PROBLEM.includes(name)));
  const optimizer = mapOf(left["optimizer"]) as Record<string, unknown>;
  if (optimizer["start_sets"] !== undefined) left["optimizer"] = Object.fromEntries(Object.entries(optimizer).filter(([name]) => name !== "start_sets"));
  return changed(left, "problem", problem);
}

/** Values with one changed; undefined without any. */
function filled(values: Readonly<Record<string, Value>>, name: string, value: Value | undefined): Record<string, unknown> | undefined {
  const made = changed(values, name, value);
  return Object.keys(made).length > 0 ? made : undefined;
}
