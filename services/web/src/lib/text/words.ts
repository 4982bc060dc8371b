/** Meanings of the terms: as tooltips, and in the glossary of the documentation. */

import type { Best, Campaign, Difference, Moving } from "../server/types";
import { count, number, percent } from "./format";

/** What happened to cells, by the kind of the cause. */
export const FAILURES = { no_result: "no result", retried: "no result at first", failed: "failed run", unscored: "score without a value" } as const;
export const OUTCOMES = ["repeated", "reused", "predicted", "simulated", "failed"] as const;
export type Outcome = (typeof OUTCOMES)[number];

export const MEANING: Record<Outcome | "pending" | "carried_over", string> = {
  carried_over: "individuals that the optimizer left unchanged: not asked for again",
  pending: "still to be answered",
  repeated: "answered by the stored result of the same parameter set",
  reused: "answered by a stored set that differs only where the influence map says that it does not matter",
  predicted: "predicted from simulated answers; it counts once a random sample of the cells that were predicted with it was simulated; never a reference, never an optimum",
  simulated: "run by the simulator; a collision or the like is a result as well, and scores as a failed run",
  failed: "without a result after all attempts: ranked last, never used as a reference",
};

const STAGES = ["claims", "sensitivity", "calibration", "robustness", "validation"];

const ENDED: readonly string[] = ["succeeded", "failed", "cancelled"];

export function hasEnded(state: string): boolean {
  return ENDED.includes(state);
}

/** The stages that have asked for cells, in their order. */
export function stagesOf(campaign: Moving): string[] {
  return STAGES.filter((stage) => (campaign.stages[stage]?.proposed ?? 0) > 0 || campaign.stage === stage);
}

/** The stage that represents a campaign in one line: the search, else what it does now, else what it did last. */
export function leadingStage(campaign: Moving): string {
  if (campaign.cells.proposed > 0) return "calibration";
  return campaign.stage ?? stagesOf(campaign).at(-1) ?? "calibration";
}

/** Requested cells that needed no simulation. */
export function withoutSimulation(cells: Partial<Record<Outcome, number>>): number {
  return OUTCOMES.reduce((sum, outcome) => sum + (outcome === "simulated" || outcome === "failed" ? 0 : (cells[outcome] ?? 0)), 0);
}

/** The seeds of a set: a list of a few, else their number. */
export const seedsText = (seeds: readonly number[]): string => (seeds.length > 5 ? `under its ${count(seeds.length)} seeds` : `under seed${seeds.length === 1 ? "" : "s"} ${seeds.join(", ")}`);

/** One sentence about the state. */
export function sentence(campaign: Moving & Partial<Pick<Campaign, "spec" | "budget">>): string {
  const { state, stage, requested_action: asked, progress } = campaign;
  if (asked === "pause") return "Asked to pause: what runs at the workers is finished first.";
  if (asked === "cancel" || state === "cancelling") return "Asked to end: what runs at the workers is finished first, and kept.";
  if (state === "queued") return "Waiting for its turn.";
  if (state === "paused") return "Paused. All results are kept; resume it at any time.";
  if (state === "succeeded") return "Finished.";
  if (state === "cancelled") return "Ended on request; what was finished is kept.";
  if (state === "failed") return "Ended with an error.";
  if (stage !== null && progress.done === 0 && progress.total > 0) return "Waiting for the workers' first results.";
  if (stage === "claims") return "Checking by simulation what stored runs mean for new parameters.";
  if (stage === "sensitivity") return "Analysing the influence of the parameters.";
  if (stage === "calibration") {
    const [now, most] = [(campaign.iteration ?? 0) + 1, campaign.spec?.optimizer?.iterations];
    return most && now > most ? "Confirming the best sets by simulation." : `Searching: ${campaign.budget ? "round" : "iteration"} ${now}.`;
  }
  if (stage === "robustness") return "Simulating the best sets in other vehicles.";
  if (stage === "validation") return "Checking earlier answers by simulation.";
  return "Running.";
}

/** Where a differing parameter matters, as a map says, which knows nothing of values outside its space. */
export function regionText({ region, reference_region: other, lower, upper }: Pick<Difference, "region" | "reference_region" | "lower" | "upper">): string {
  if (region === "outside" || other === "outside") return "nothing: a value lies outside its space";
  if (lower === null && upper === null) return region === "influential" ? "matters everywhere" : "matters nowhere";
  return `matters ${lower === null ? "" : `from ${number(lower)} `}${upper === null ? "on" : `up to ${number(upper)}`}`;
}

/** By how much a set breaks constraints, or that it is not known; empty if it keeps them. */
export function brokenText({ violation, undecided }: Pick<Best, "violation" | "undecided">): string {
  return undecided ? "not known to keep its rates" : violation > 0 ? `breaks constraints by ${percent(violation)}` : "";
}

/** The interval of the objective of a random simulator; empty without one. */
export function intervalText({ lower, upper }: Pick<Best, "lower" | "upper">): string {
  const ends = [lower, upper].map((end) => (typeof end === "number" ? number(end) : "unknown"));
  return ends.every((end) => end === "unknown") ? "" : ends.join(" to ");
}

/** What the runs of a random simulator tell of a ranked set; empty without them. */
export function knownOf(set: Pick<Best, "lower" | "upper" | "failures" | "replicates"> & { seeds: readonly number[] }): string {
  const interval = intervalText(set);
  return interval && `Objective ${interval} by ${count(Math.max(1, set.seeds.length))} of its ${count(set.replicates)} seeds; ${count(set.failures)} of all its runs failed.`;
}

/** The signs of lights; `open` while a search goes on. */
export const LIGHTS: Record<"green" | "amber" | "red" | "neutral" | "open", string> = { green: "✓", amber: "!", red: "✕", neutral: "≈", open: "…" };
