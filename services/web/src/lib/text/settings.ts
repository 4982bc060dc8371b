/** The settings of a campaign as rows for readers. */

import { number, percent } from "./format";
import { settingsText, studiesOf } from "./studies";
import type { Campaign, CampaignSetup } from "../server/types";

type Asked = Pick<Campaign, "kind" | "spec">;
type Settings = Readonly<Record<string, unknown>>;

function isSettings(value: unknown): value is Settings {
  return typeof value === "object" && value !== null && !Array.isArray(value);
}

function text(value: unknown): string {
  if (typeof value === "number") return number(value, 6);
  if (Array.isArray(value)) return value.every((entry) => typeof entry !== "object") ? value.map(text).join(", ") : `${value.length} of them`;
  if (isSettings(value)) return list(value);
  return String(value);
}

/** `population 200, iterations 15`; what is empty or null is left out. */
function list(settings: Settings, without: readonly string[] = []): string {
  return Object.entries(settings)
    .filter(([name, value]) => !without.includes(name) && value !== null && !(Array.isArray(value) && value.length === 0) && !(isSettings(value) && Object.keys(value).length === 0))
    .map(([name, value]) => (value === true ? name.replaceAll("_", " ") : value === false ? `not ${name.replaceAll("_", " ")}` : `${name.replaceAll("_", " ")} ${text(value)}`))
    .join(", ");
}

function named(name: unknown, more: string): string {
  return [String(name), more].filter(Boolean).join(": ");
}

/** A goal in words: `peak jerk: minimise`. What every goal has by default is left out. */
function goalText(goal: Settings): string {
  const usual = Object.entries(goal).filter(([name, value]) => !(name === "aggregate" && value === "mean") && !(name === "scenarios" && value === "all") && !(name === "tolerance" && value === 0) && value !== null);
  const { name, score, measure, direction, ...others } = Object.fromEntries(usual);
  return named(name ?? score ?? measure, [direction ? String(direction) : "", list(others)].filter(Boolean).join(", "));
}

/** Names and texts. Scenarios with their weights are the setup's, which knows all of them; without it, those that were named. */
export function asked(campaign: Asked, setup: CampaignSetup | null): [string, string][] {
  const { spec } = campaign;
  const rows: [string, string | null][] = [];
  const own = typeof spec["problem"] === "string" && spec["problem"] !== "highway"; // a simulator of the user's own drives no vehicle of ours
  const vehicle = spec["vehicle"];
  const function_ = setup?.scenarios.find((scenario) => scenario.driving_function)?.driving_function ?? spec["driving_function"];
  const model = setup?.scenarios.find((scenario) => scenario.vehicle)?.vehicle ?? (isSettings(vehicle) ? vehicle["model"] : undefined);
  if (setup === null) {
    rows.push(["Scenarios", spec["catalogue"] === undefined ? null : own && spec["catalogue"] === "highway" ? "all" : text(spec["catalogue"])]);
    rows.push(["Weights", isSettings(spec.weights) && Object.keys(spec.weights).length > 0 ? list(spec.weights) : null]);
  }
  rows.push(["Problem", own ? String(spec["problem"]) : null]);
  rows.push(["Simulator", own ? (setup?.scenarios.find((scenario) => scenario.simulator)?.simulator ?? null) : null]);
  rows.push(["Driving function", own || function_ === undefined ? null : String(function_)]);
  rows.push(["Vehicle", own ? null : model === undefined ? null : named(model, isSettings(vehicle) && isSettings(vehicle["parameters"]) ? list(vehicle["parameters"]) : "")]);
  rows.push(["Evaluator", setup?.evaluator.replace(/\b([0-9a-f]{8})[0-9a-f]{16,}\b/, "$1") ?? (spec["evaluator"] === undefined || (own && spec["evaluator"] === "reference") ? null : String(spec["evaluator"]))]);
  rows.push(["Held fixed", isSettings(spec["fixed"]) ? list(spec["fixed"]) : null]);
  rows.push(["Baseline", isSettings(spec["baseline"]) ? list(spec["baseline"]) : null]);
  if (isSettings(spec.optimizer)) rows.push(["Optimizer", named(spec.optimizer["kind"], list(spec.optimizer, ["kind"]))]);
  for (const name of ["objectives", "constraints"]) {
    const goals = spec[name];
    if (Array.isArray(goals) && goals.length > 0) rows.push([name.charAt(0).toUpperCase() + name.slice(1), goals.filter(isSettings).map(goalText).join("; ")]);
  }
  if (isSettings(spec.sensitivity)) rows.push(["Sensitivity", typeof spec.sensitivity["map"] === "string" ? `the stored influence map ${spec.sensitivity["map"].slice(0, 8)}` : list(spec.sensitivity)]);
  if (isSettings(spec.reduction) && spec.optimizer !== null) {
    const { mode, audit, max_error: most, confirm, tolerance, limit } = spec.reduction;
    const reuses = mode === "influence" || mode === "both";
    const lots = mode === "predicted" || mode === "both" ? `predictions within ${tolerance === undefined || tolerance === null ? "the score's tolerance (0 if it has steps)" : number(Number(tolerance))}, at most ${percent(Number(limit))} of them expected to be released and wrong` : "";
    const audits = reuses ? `${percent(Number(audit))} audited, ${Number(most) < 1 ? `at most ${percent(Number(most))} of the answers in lots expected to be released and wrong` : "no lots"}` : "";
    const confirmed = reuses && confirm ? `best set confirmed by simulation, at most ${String(confirm)} sets` : "";
    rows.push(["Reduction", named(mode, [audits, lots, (spec.reduction as Settings)["narrow"] === true ? "influenced ranges alone searched" : "", list(spec.reduction, ["mode", "audit", "max_error", "confirm", "tolerance", "limit", "narrow", "certified"]), confirmed].filter(Boolean).join(", "))]);
  }
  for (const stage of studiesOf(campaign)) rows.push([stage === "robustness" ? "Robustness" : "Validation", settingsText(stage, spec[stage] ?? {})]);
  return rows.filter((row): row is [string, string] => row[1] !== null && row[1] !== "");
}
