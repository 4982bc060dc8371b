/** Campaigns as rows of a table: filtered, sorted, studies below what they examine. */

import { withoutSimulation } from "./words";
import { number } from "./format";
import { calibrates } from "./studies";
import type { Campaign, CellCounts } from "../server/types";

export const COLUMNS = ["name", "state", "best", "saved", "simulated", "took", "created"] as const;
export type Column = (typeof COLUMNS)[number];
export type Order = readonly [Column, "up" | "down"];

type Known = Pick<Campaign, "id" | "name" | "kind" | "state" | "spec" | "links" | "best" | "cells" | "stages" | "seconds" | "created_at" | "tags">;

/** The cells of the search; without a search, the cells of all stages together. */
export function countedCells(campaign: Pick<Known, "cells" | "stages">): Pick<CellCounts, "requested" | "simulated" | "repeated" | "reused" | "predicted"> {
  if (campaign.cells.proposed > 0) return campaign.cells;
  const sum = (name: keyof CellCounts): number => Object.values(campaign.stages).reduce((total, cells) => total + (cells[name] ?? 0), 0);
  return { requested: sum("requested"), simulated: sum("simulated"), repeated: sum("repeated"), reused: sum("reused"), predicted: sum("predicted") };
}

/** The share of requested cells that needed no simulation; null before the first. */
export function savedShare(campaign: Pick<Known, "cells" | "stages">): number | null {
  const cells = countedCells(campaign);
  return cells.requested > 0 ? withoutSimulation(cells) / cells.requested : null;
}

/** The name of a campaign's problem, which a specification names by its digest; empty if a list leaves a long specification out. */
export function problemNameOf({ spec }: Pick<Known, "spec">, problems: readonly { name: string; digest: string }[]): string {
  const digest = String(spec["problem"] ?? "");
  return problems.find((entry) => entry.digest === digest)?.name ?? digest.slice(0, 12);
}

/** Weights in few words, the heaviest first, without weights of 1. Empty if all are 1. */
export function weighted(weights: Readonly<Record<string, number>> | null | undefined, most = 4): string {
  const told = Object.entries(weights ?? {}).filter(([, weight]) => weight !== 1).sort(([, a], [, b]) => b - a);
  if (told.length === 0) return "";
  return `weights ${told.slice(0, most).map(([name, weight]) => `${name} ${number(weight)}`).join(", ")}${told.length > most ? ", …" : ""}`;
}

/** Sections of a specification by whose words a campaign is looked for. */
const SETTINGS = ["optimizer", "optimizers", "reduction", "objectives", "constraints", "evaluator", "driving_function", "vehicle"];

/** The words among the values of a setting: names of optimizers, modes, scores. */
function wordsIn(value: unknown): string[] {
  if (typeof value === "string") return [value];
  return typeof value === "object" && value !== null ? Object.values(value).flatMap(wordsIn) : [];
}

/** Whether a search of people finds a campaign: every word is in its name, the beginning of its id, its kind, its problem, its settings or a tag. */
export function isFound(campaign: Known, search: string, problem = ""): boolean {
  const text = [campaign.name, campaign.kind, campaign.state, String(campaign.spec["problem"] ?? ""), problem, ...SETTINGS.flatMap((name) => wordsIn(campaign.spec[name])), ...campaign.tags].join(" ").toLowerCase();
  return search.toLowerCase().split(/\s+/).filter(Boolean).every((word) => text.includes(word) || campaign.id.startsWith(word));
}

/** The id of the campaign that a study examines, if it is among those known; its map's maker counts as well. */
export function subjectOf(campaign: Known, known: readonly Known[]): string | null {
  if (calibrates(campaign)) return null;
  const of = campaign.spec.robustness?.["of"] ?? campaign.spec.validation?.["of"];
  if (typeof of === "string") return known.find((entry) => entry.id === of)?.id ?? null;
  const map = campaign.spec.sensitivity?.["map"];
  if (typeof map !== "string") return null;
  // The list is newest first: the oldest campaign with this map made it.
  return known.findLast((entry) => entry.id !== campaign.id && calibrates(entry) && entry.links["influence_map"]?.endsWith(`/${map}`))?.id ?? null;
}

/** Null if there is none yet. */
function valueOf(campaign: Known, column: Column): number | string | null {
  if (column === "name" || column === "state") return campaign[column].toLowerCase();
  if (column === "best") return campaign.best?.objective ?? null;
  if (column === "saved") return savedShare(campaign);
  if (column === "simulated") return countedCells(campaign).simulated;
  return column === "took" ? campaign.seconds.wall : (campaign.created_at ?? "");
}

/** The campaigns that a search finds, in order; studies follow what they examine, `below` it, if that is listed. `problemOf`: the name of a campaign's problem. */
export function arranged<T extends Known>(campaigns: readonly T[], search: string, [column, way]: Order, problemOf: (campaign: T) => string = () => ""): { campaign: T; below: boolean }[] {
  const sign = way === "up" ? 1 : -1;
  const listed = campaigns.filter((campaign) => isFound(campaign, search, problemOf(campaign)));
  const ordered = [...listed].sort((a, b) => {
    const [x, y] = [valueOf(a, column), valueOf(b, column)];
    if (x === null || y === null) return Number(x === null) - Number(y === null);
    return x === y ? 0 : sign * (x < y ? -1 : 1);
  });
  const subjects = new Map(ordered.map((campaign) => [campaign.id, subjectOf(campaign, listed)]));
  return ordered
    .filter((campaign) => subjects.get(campaign.id) === null)
    .flatMap((campaign) => [{ campaign, below: false }, ...ordered.filter((entry) => subjects.get(entry.id) === campaign.id).map((entry) => ({ campaign: entry, below: true }))]);
}
