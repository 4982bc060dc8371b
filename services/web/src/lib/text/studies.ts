/** Campaigns that calibrate nothing: they examine what others found. */

import { count, number } from "./format";
import { condition } from "../charts/robust";
import type { Campaign, Study } from "../server/types";

export type StudyStage = Study["stage"];

const STAGES: readonly StudyStage[] = ["robustness", "validation"];
/** What decides what a degree means; `seed` draws the vehicles. */
const BOXES = ["delta", "steps", "samples", "eta", "condition", "refinements", "seed"] as const;

type Known = Pick<Campaign, "kind" | "spec">;

/** Whether it searches for parameters. In a list, long specifications are left out: then it is taken to. */
export function calibrates(campaign: Known): boolean {
  return campaign.kind !== "calibration" || campaign.spec.optimizer !== null;
}

/** The studies that a campaign makes, whether it calibrates besides or not. */
export function studiesOf(campaign: Known): StudyStage[] {
  return STAGES.filter((stage) => typeof campaign.spec[stage] === "object" && campaign.spec[stage] !== null);
}

/** What a campaign is called where a calibration would show its best objective. */
export function kindOf(campaign: Known): string {
  if (campaign.kind !== "calibration") return campaign.kind;
  if (calibrates(campaign)) return "";
  return studiesOf(campaign).map((stage) => `${stage} study`).join(", ") || (campaign.spec.sensitivity ? "sensitivity analysis" : "");
}

/** How a study is made, in words. */
export function settingsText(stage: StudyStage, settings: Readonly<Record<string, unknown>>): string {
  const value = (name: string): number => Number(settings[name] ?? 0);
  if (stage === "validation" && settings["of"]) return `at most ${count(value("samples"))} released predictions of each scenario, simulated`;
  if (stage === "validation") return `${count(value("references"))} variants of each set, of Latin hypercubes from ${count(value("samples"))} to ${count(value("largest"))} sets`;
  const halvings = value("refinements") > 0 ? `, then ${value("refinements")} halvings` : "";
  return `up to ${value("steps")} boxes, each wider by ${number(value("delta"), 4)}${halvings}, with ${count(value("samples"))} vehicles in each; condition: ${condition(settings)}`;
}

/** Whether the degrees of two robustness studies mean the same. */
export function sameBoxes(first: Readonly<Record<string, unknown>>, other: Readonly<Record<string, unknown>>): boolean {
  return BOXES.every((name) => JSON.stringify(first[name]) === JSON.stringify(other[name]));
}
