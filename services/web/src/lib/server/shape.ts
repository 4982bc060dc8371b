/** A problem as forms and tables need it, whether it is installed or was pushed. */

import { get } from "./api.svelte";
import type { ParameterAnswer, ParameterSpacePage, ProblemAnswer, ScenarioPage } from "./types";

/** Of a campaign that names none. */
export const DEFAULT_PROBLEM = "highway";

/** Bounds of a choice are positions; only a grid has a step. */
export type ShapeParameter = Pick<ParameterAnswer, "name" | "kind" | "unit" | "description" | "lower" | "upper" | "step" | "choices">;

export interface ShapeScore {
  name: string;
  direction: "maximise" | "minimise";
  range: readonly [number, number];
  unit: string;
  /** Null of a score that an evaluator gives. */
  formula: string | null;
  evaluator: string | null;
  tolerance: number;
  failed: number | null;
}

/** The answer about a problem with lists of its parameters, scenarios and scores. */
export interface Shape extends Omit<ProblemAnswer, "parameters" | "scenarios" | "scores"> {
  /** The driving function of drivecal's own planner; null of other simulators. */
  driving: string | null;
  parameters: ShapeParameter[];
  /** The curve or map of each coefficient, by its name. */
  curves: Readonly<Record<string, string>>;
  scenarios: { id: string; title: string }[];
  /** Scores that a campaign can choose. */
  scores: ShapeScore[];
}

export function shapeOf(problem: ProblemAnswer): Shape {
  return {
    ...problem,
    driving: isDriven(problem) ? String((problem.simulator["controller"] as Record<string, unknown>)["driving_function"]) : null,
    parameters: Object.entries(problem.parameters).map(([name, entry]) => declared(name, entry)),
    curves: Object.fromEntries(Object.entries(problem.shapes).flatMap(([curve, { names }]) => names.map((coefficient) => [coefficient, curve]))),
    scenarios: Object.entries(problem.scenarios).map(([id, data]) => ({ id, title: typeof data["title"] === "string" ? data["title"] : dataText(data) })),
    scores: Object.entries(problem.scores).map(([name, entry]) => ({ name, ...(entry as Omit<ShapeScore, "name">) })),
  };
}

function declared(name: string, entry: Readonly<Record<string, unknown>>): ShapeParameter {
  const choices = Array.isArray(entry["choices"]) ? entry["choices"].map(String) : [];
  const step = typeof entry["step"] === "number" ? entry["step"] : null;
  return {
    name,
    kind: choices.length > 0 ? "choice" : entry["integer"] === true ? "integer" : step === null ? "continuous" : "grid",
    unit: String(entry["unit"] ?? "1"),
    description: String(entry["description"] ?? ""),
    lower: choices.length > 0 ? 0 : Number(entry["lower"]),
    upper: choices.length > 0 ? choices.length - 1 : Number(entry["upper"]),
    step,
    choices,
  };
}

/** A problem of drivecal's own planner with the plug-ins that a campaign chooses: another driving function, space or catalogue. */
export function withPlugins(shape: Shape, spaces: ParameterSpacePage, scenarios: ScenarioPage, wanted: Readonly<Record<string, unknown>>): Shape {
  if (shape.driving === null) return shape;
  const driving = wanted["driving_function"] ?? shape.driving;
  const own = spaces.items.filter((entry) => entry.driving_function === driving);
  const space = own.find((entry) => entry.name === wanted["parameters"] && entry.name !== DEFAULT_PROBLEM) ?? (driving === shape.driving ? undefined : own[0]);
  const listed = scenarios.items.filter((entry) => entry.catalogue === wanted["catalogue"] && entry.catalogue !== DEFAULT_PROBLEM);
  return {
    ...shape,
    parameters: space?.parameters.map((entry) => ({ ...entry, step: entry.kind === "grid" ? entry.step : null })) ?? shape.parameters,
    scenarios: listed.length > 0 ? listed.map((entry) => ({ id: entry.id, title: entry.title })) : shape.scenarios,
  };
}

/** Whether drivecal's own planner drives the scenarios, so that a replay needs their roads. */
export function isDriven(problem: Pick<ProblemAnswer, "scenarios" | "simulator">): boolean {
  return problem.simulator["kind"] === "highway" && Object.values(problem.scenarios).every((data) => "task" in data);
}

/** A problem by its name or digest. */
export function problemOf(name: string, signal?: AbortSignal): Promise<ProblemAnswer> {
  return get<ProblemAnswer>(`/problems/${encodeURIComponent(name)}`, signal);
}

/** The data of a scenario on one line. */
export function dataText(data: Readonly<Record<string, unknown>>): string {
  return Object.entries(data).map(([name, value]) => `${name} ${typeof value === "object" ? JSON.stringify(value) : String(value)}`).join(", ");
}

/** The values that a parameter may take, in words. */
export function valuesText({ kind, lower, upper, step, choices }: ShapeParameter): string {
  if (kind === "choice") return choices.join(", ");
  const by = kind === "integer" ? ", whole numbers" : step === null ? "" : `, step ${String(Number(step.toPrecision(9)))}`;
  return `${lower} to ${upper}${by}`;
}

/** What a score is, in a few words: `cost / EUR, 0 to 100, less is better`. */
export function scoreText({ name, unit, range, direction }: ShapeScore): string {
  return `${name}${unit === "1" ? "" : ` / ${unit}`}, ${range[0]} to ${range[1]}, ${direction === "minimise" ? "less" : "more"} is better`;
}
