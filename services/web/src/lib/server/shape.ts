/** A problem as forms and tables need it, whether it is built in or was pushed. */

import type { ParameterSpacePage, ProblemAnswer, ScenarioPage } from "./types";

export const HIGHWAY = "highway";
const FUNCTION = "frenet";

export type Kind = "grid" | "continuous" | "integer" | "choice";

export interface ShapeParameter {
  name: string;
  kind: Kind;
  unit: string;
  meaning: string;
  /** Of a choice: positions. */
  lower: number;
  upper: number;
  /** Of a grid. */
  step: number | null;
  choices: readonly string[];
}

export interface ShapeScore {
  name: string;
  direction: "maximise" | "minimise";
  range: readonly [number, number];
  unit: string;
  formula: string;
  tolerance: number;
  failed: number | null;
}

export interface Shape {
  name: string;
  /** Null of the built-in problem. */
  digest: string | null;
  description: string;
  simulator: string;
  parameters: ShapeParameter[];
  constraints: readonly string[];
  baseline: Readonly<Record<string, number | string>> | null;
  scenarios: { id: string; title: string }[];
  /** Scores that a campaign can choose. */
  scores: ShapeScore[];
  /** Names for objectives and constraints. */
  goals: { scores: readonly string[]; measures: readonly string[] };
}

/** A pushed problem. */
export function shapeOf(problem: ProblemAnswer): Shape {
  return {
    name: problem.name,
    digest: problem.digest,
    description: problem.description,
    simulator: String(problem.simulator["kind"]),
    constraints: problem.constraints,
    baseline: problem.baseline,
    parameters: Object.entries(problem.parameters).map(([name, entry]) => declared(name, entry)),
    scenarios: Object.entries(problem.scenarios).map(([id, data]) => ({ id, title: dataText(data) })),
    scores: Object.entries(problem.scores).map(([name, entry]) => ({ name, ...(entry as Omit<ShapeScore, "name">) })),
    goals: { scores: Object.keys(problem.scores), measures: Object.keys(problem.measures) },
  };
}

function declared(name: string, entry: Readonly<Record<string, unknown>>): ShapeParameter {
  const choices = Array.isArray(entry["choices"]) ? entry["choices"].map(String) : [];
  const step = typeof entry["step"] === "number" ? entry["step"] : null;
  return {
    name,
    kind: choices.length > 0 ? "choice" : entry["integer"] === true ? "integer" : step === null ? "continuous" : "grid",
    unit: String(entry["unit"] ?? "1"),
    meaning: String(entry["description"] ?? ""),
    lower: choices.length > 0 ? 0 : Number(entry["lower"]),
    upper: choices.length > 0 ? choices.length - 1 : Number(entry["upper"]),
    step,
    choices,
  };
}

/** The built-in problem, by what is installed: the parameters of a driving function and the scenarios of a catalogue, or of the one with a scenario of the list. */
export function highwayShape(spaces: ParameterSpacePage, scenarios: ScenarioPage, driving: unknown = FUNCTION, catalogue: unknown = HIGHWAY, parameters: unknown = HIGHWAY): Shape {
  const own = spaces.items.filter((entry) => entry.driving_function === driving);
  const space = own.find((entry) => entry.name === parameters) ?? own[0];
  const listed = Array.isArray(catalogue) ? scenarios.items.find((entry) => catalogue.includes(entry.id))?.catalogue : catalogue;
  const scores = ["reference", "learned"].map((name): ShapeScore => ({ name, direction: "maximise", range: [0, 7], unit: "points", formula: "comfort", tolerance: 1, failed: 0 }));
  return {
    name: HIGHWAY,
    digest: null,
    description: "A trajectory planner on a motorway in traffic, built in",
    simulator: HIGHWAY,
    constraints: [],
    baseline: null,
    parameters: (space?.parameters ?? []).map((entry) => ({ name: entry.name, kind: entry.kind as Kind, unit: entry.unit, meaning: entry.description, lower: entry.lower, upper: entry.upper, step: entry.kind === "grid" ? entry.step : null, choices: entry.choices })),
    scenarios: scenarios.items.filter((entry) => entry.catalogue === listed).map((entry) => ({ id: entry.id, title: entry.title })),
    scores,
    goals: { scores: scenarios.scores, measures: Object.keys(scenarios.measures) },
  };
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
