/** What happened to campaigns since a moment: which ended, what has a better answer, and what needs a person. */

import { wordsText } from "../address";
import { hasFront } from "../front/sets";
import type { Campaign, ResultTrust, ResultVerdict } from "../server/types";
import { count, percent } from "./format";
import { changeOf, gain } from "./scores";
import { calibrates } from "./studies";

/** By parts of codes, the first that fits. `at`: a section of the overview. */
const PLACES: readonly (readonly [RegExp, string, Record<string, string>, string])[] = [
  [/^front/, "front", {}, "front"],
  [/map|audits|contradictions|lots|predictions|robust/, "trust", {}, "checks"],
  [/^fails$|^without|^failing/, "overview", { at: "failures" }, "failed runs"],
  [/noise|cut$/, "evaluations", {}, "evaluations"],
  [/baseline|better|ends$/, "overview", { at: "best" }, "best set"],
  [/confirm|scores|tried|judged|constraints|optima/, "ranking", { row: "1" }, "ranking"],
  [/failed|no_result|cancelled/, "overview", { at: "log" }, "log"],
];
const COURSE = [/./, "overview", { at: "course" }, "course"] as const;

/** The view with the numbers of a verdict. `set`: values of the judged set by their columns in the evaluations, where its failed runs come first. */
export function evidenceOf({ code }: Pick<ResultVerdict, "code">, set: Readonly<Record<string, number | string>> = {}): { view: string; query: Record<string, string>; title: string } {
  const own = Object.entries(set).map(([column, value]): [string, string] => (typeof value === "number" ? [`b.${column}`, `${value}:${value}`] : [`w.${column}`, wordsText([value])]));
  if (code === "failing_runs" && own.length > 0) return { view: "evaluations", query: { ...Object.fromEntries(own), sort: "failure" }, title: "its failed runs" };
  const [, view, query, title] = PLACES.find(([codes]) => codes.test(code)) ?? COURSE;
  return { view, query, title };
}

const DAY_MILLISECONDS = 86_400_000;
const AWAY_MILLISECONDS = 3_600_000;
/** Settings that decide what an objective means: only campaigns with equal ones are compared. */
const DECIDING = ["problem", "catalogue", "driving_function", "vehicle", "evaluator", "weights", "objectives", "constraints", "replicates"];

/** The visit that goes on, or begins because the start page was out of sight for an hour; `kept` is what the last call returned to keep. `known`: it is the end of an earlier visit in this browser, and not the last 24 hours. */
export function visitAt(kept: string | null, now: number): { since: number; known: boolean; keep: string } {
  const [since = NaN, seen = NaN] = (kept ?? "").split(" ").map((part) => Number.parseInt(part, 10));
  const from = now - seen > AWAY_MILLISECONDS ? seen : since;
  const known = Number.isFinite(from) && from <= now;
  return { since: known ? from : now - DAY_MILLISECONDS, known, keep: `${Number.isFinite(from) ? from : ""} ${now}` };
}

export interface Better {
  campaign: Campaign;
  /** The value before: of another campaign, or of the baseline. */
  before: number;
  of: Campaign | null;
  /** The scenario with the largest gain. */
  scenario: string;
}

/** Whether a campaign ran after a moment. */
const isNew = ({ ended_at, started_at }: Campaign, since: number): boolean => started_at !== null && (ended_at === null || Date.parse(ended_at) > since);

/** The best new campaign of each question whose best value beats those before by more than the tolerance. Fronts have no best set. */
export function betterSince(known: readonly Campaign[], since: number): Better[] {
  const asked = known.filter((campaign) => campaign.best && campaign.best.violation === 0 && campaign.spec["problem"] !== undefined && calibrates(campaign) && !hasFront(campaign.spec));
  const questions = Map.groupBy(asked, ({ spec, scale }) => JSON.stringify([scale, ...DECIDING.map((name) => spec[name])]));
  return [...questions.values()].flatMap((campaigns): Better[] => {
    const minimised = (campaigns[0]?.objective ?? campaigns[0]?.scale)?.direction === "minimise";
    const ahead = (from: readonly Campaign[]): Campaign | undefined => [...from].sort((a, b) => -(gain(a.best?.objective, b.best?.objective, minimised) ?? 0))[0];
    const now = ahead(campaigns.filter((campaign) => isNew(campaign, since)));
    const old = ahead(campaigns.filter((campaign) => !isNew(campaign, since)));
    const before = old?.best ?? now?.baseline;
    const gained = gain(now?.best?.objective, before?.objective, minimised);
    if (!now?.best || typeof before?.objective !== "number" || gained === null || changeOf(gained, now.objective ? 0 : now.scale.tolerance) !== "better") return [];
    // Runs of a random simulator may leave open which set is better.
    const [end, other] = minimised ? [now.best.upper, old?.best?.lower] : [now.best.lower, old?.best?.upper];
    if (old ? (gain(end, other, minimised) ?? 1) <= 0 : now.baseline?.close || ((now.best.replicates ?? 1) > 1 && (now.baseline?.gain ?? 0) <= 0)) return [];
    const gains = Object.entries(now.best.scores).map(([name, score]) => ({ name, by: gain(score, before.scores[name], now.scale.direction === "minimise") ?? 0 }));
    return [{ campaign: now, before: before.objective, of: old ?? null, scenario: gains.sort((a, b) => b.by - a.by)[0]?.name ?? "" }];
  });
}

/** The gravest first. */
const KINDS = ["failed", "degraded", "nothing feasible", "waiting", "doubtful", "not finished", "paused"] as const;

/** What a campaign needs a person for, with the next thing to do: a place to go to, or to resume it. */
export interface Need {
  campaign: Campaign;
  kind: (typeof KINDS)[number];
  why: string;
  title: string;
  path: readonly string[];
  query?: Record<string, string>;
}

/** The list of what needs a person. Ended campaigns without `trust` are not judged yet. */
export function needsOf(known: readonly Campaign[], since: number, trust: Readonly<Record<string, ResultTrust>>): Need[] {
  const needs = known.flatMap((campaign): Need[] => {
    const { id, state, best } = campaign;
    const again = { path: ["submit"], query: { from: id } };
    if (campaign.ended_at === null) {
      if (campaign.degraded) return [{ campaign, kind: "degraded", why: campaign.degraded, title: "See the workers", path: ["workers"] }];
      if (campaign.waiting && state === "running") return [{ campaign, kind: "waiting", why: campaign.waiting, title: "See who holds it", path: ["workers"] }];
      return state === "paused" && !campaign.requested_action ? [{ campaign, kind: "paused", why: "It goes on when you resume it.", title: "Resume", path: [] }] : [];
    }
    if (Date.parse(campaign.ended_at) <= since || state === "cancelled") return [];
    if (state === "failed") return [{ campaign, kind: "failed", why: campaign.error ?? "It ended with an error.", title: "Start it again", ...again }];
    if (!calibrates(campaign)) return [];
    if (!best) return [{ campaign, kind: "nothing feasible", why: "No set has a result in every scenario.", title: "See the log", path: ["campaigns", id, "overview"], query: { at: "log" } }];
    if (best.violation > 0 && !best.undecided) return [{ campaign, kind: "nothing feasible", why: `${(best.replicates ?? 1) > 1 ? "By its runs, the best set breaks the constraints" : "No set keeps all constraints; the best one breaks them"} by ${percent(best.violation)}.`, title: "Change the constraints", ...again }];
    const doubts = trust[id]?.verdicts.filter(({ light }) => light === "red" || light === "amber") ?? [];
    const doubt = doubts.find(({ light }) => light === "red") ?? doubts.find(({ question }) => question !== "search") ?? doubts[0];
    if (!doubt) return [];
    const on = { ...again, query: { from: id, start: JSON.stringify([best.parameters]) } };
    if (doubt.code === "at_ends" && (doubt.numbers["entries"] as unknown[]).length > 0) return [{ campaign, kind: "not finished", why: doubt.text, title: "Push it with a wider range", path: ["problems"] }];
    if (doubt.question === "search") return [{ campaign, kind: "not finished", why: doubt.text, title: doubt.code === "at_ends" ? "Widen the range" : "Search on from its best set", ...on }];
    const { view, query, title } = evidenceOf(doubt);
    return [{ campaign, kind: "doubtful", why: doubt.text, title: `See the ${title}`, path: ["campaigns", id, view], query }];
  });
  // What the server lacks is one cause, however many campaigns wait for it.
  const [first, others] = [needs.find(({ kind }) => kind === "degraded"), needs.filter(({ kind }) => kind !== "degraded")];
  const degraded = needs.length - others.length;
  if (first) others.push(degraded > 1 ? { ...first, why: `${first.why}; ${count(degraded - 1)} more campaigns` } : first);
  return others.sort((a, b) => KINDS.indexOf(a.kind) - KINDS.indexOf(b.kind));
}
