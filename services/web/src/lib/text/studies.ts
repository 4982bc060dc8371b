/** Campaigns that calibrate nothing: they examine what others found. */

import type { Campaign, CampaignSetup, Study } from "../server/types";

export type StudyStage = Study["stage"];
/** What a study examines: the best sets in other vehicles, an influence map, released predictions. */
export type Examined = "robustness" | "map" | "predictions";

const STAGES: readonly StudyStage[] = ["robustness", "validation"];

type Known = Pick<Campaign, "kind" | "spec">;

/** Whether it searches for parameters, as no study and no single evaluation does; assumed if a list leaves out a long specification. */
export function calibrates(campaign: Known): boolean {
  return campaign.kind === "calibration" && campaign.spec.optimizer !== null;
}

/** The studies that a campaign makes, whether it calibrates besides or not. */
export function studiesOf(campaign: Known): StudyStage[] {
  return STAGES.filter((stage) => typeof campaign.spec[stage] === "object" && campaign.spec[stage] !== null);
}

/** What a campaign without a calibration is. */
export function kindOf(campaign: Known): string {
  if (calibrates(campaign)) return "";
  return studiesOf(campaign).map((stage) => `${stage} study`).join(", ") || (campaign.spec.sensitivity ? "sensitivity analysis" : "");
}

/** All released predictions of a scenario. */
const EVERY = 1_000_000;
const OF_A_STUDY = /( \((robustness|validation)( in [^()]*)?\))+$/;

/** Whether runs have side conditions, such as the vehicle's mass, that a robustness study varies: of one vehicle, while variants have others. */
export function isVaried(setup: { scenarios: readonly Pick<CampaignSetup["scenarios"][number], "scenario" | "vehicle_parameters">[] } | null): boolean {
  return setup?.scenarios.some(({ scenario, vehicle_parameters }) => vehicle_parameters !== null && !scenario.includes("@")) ?? false;
}

/** The studies that can be made of an ended search. */
export function possibleStudies(campaign: Pick<Campaign, "kind" | "spec" | "links" | "best" | "ended_at" | "cells">, setup: Parameters<typeof isVaried>[0]): Examined[] {
  if (!calibrates(campaign) || campaign.ended_at === null || campaign.best === null) return [];
  const there: Record<Examined, boolean> = { robustness: isVaried(setup), map: campaign.links["influence_map"] !== undefined, predictions: campaign.cells.predicted > 0 };
  return (["robustness", "map", "predictions"] as const).filter((examined) => there[examined]);
}

/** The stage of a campaign that examines it. */
export function stageOf(examined: Examined): StudyStage {
  return examined === "robustness" ? examined : "validation";
}

/** The specification of a campaign that makes only a study of another one, as `drivecal robustness` and `drivecal validate` submit it; `settings`: other ones than the defaults. */
export function studySpecification(campaign: Pick<Campaign, "id" | "name" | "spec" | "links">, examined: Examined, settings: Readonly<Record<string, unknown>> = {}): Record<string, unknown> {
  const stages = {
    robustness: { robustness: { ...settings, of: campaign.id } },
    map: { sensitivity: { map: campaign.links["influence_map"]?.split("/").at(-1) }, validation: settings },
    predictions: { validation: { samples: EVERY, ...settings, of: campaign.id } },
  }[examined];
  return { ...campaign.spec, optimizer: null, sensitivity: null, robustness: null, validation: null, ...stages, name: `${campaign.name.replace(OF_A_STUDY, "").slice(0, 180)} (${stageOf(examined)})` };
}

/** The settings of a study that a user may choose, with the defaults that differ from the schema's. */
export function studySettings(examined: Examined): { schema: string; names: readonly string[]; defaults: Readonly<Record<string, unknown>> } {
  if (examined === "robustness") return { schema: "RobustnessSpecification", names: ["delta", "steps", "samples", "eta", "condition", "solutions", "seed"], defaults: {} };
  if (examined === "predictions") return { schema: "ValidationSpecification", names: ["samples", "seed"], defaults: { samples: EVERY } };
  return { schema: "ValidationSpecification", names: ["samples", "references", "largest", "seed"], defaults: {} };
}
