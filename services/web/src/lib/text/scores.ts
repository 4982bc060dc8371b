/** How much better a score is than another; and the scores that can order a ranking of stored sets: the scores of the campaign's push of its problem, and what the latest push declares otherwise. */

import { scoreText, shapeOf, type ShapeScore } from "../server/shape";
import type { Campaign, ProblemAnswer, Scale } from "../server/types";

export interface OfferedScore {
  /** As the API names it; empty: what the campaign searched for. */
  value: string;
  title: string;
  scale: Scale;
}

/** The offered scores, the campaign's own first; of the latest push only those with another definition. `own`: the campaign's push. */
export function offeredScores(campaign: Pick<Campaign, "spec" | "scale">, own: ProblemAnswer, latest: ProblemAnswer | null): OfferedScore[] {
  const declared = shapeOf(own).scores;
  const searched = declared.find((score) => score.name === campaign.spec["evaluator"]);
  const goals = (["objectives", "constraints"] as const).some((goal) => ((campaign.spec[goal] as unknown[] | null | undefined) ?? []).length > 0);
  const first = { value: "", title: goals || searched === undefined ? "the campaign's objective" : scoreText(searched), scale: campaign.scale };
  const others = declared.filter((score) => goals || score !== searched).map((score) => offered(score, score.name));
  if (latest === null || latest.digest === own.digest) return [first, ...others];
  const changed = shapeOf(latest).scores.filter((score) => declared.every((known) => definition(known) !== definition(score)));
  const pushed = changed.map((score) => offered(score, `${score.name}@${latest.digest}`, `${scoreText(score)}, as in the latest push: ${score.formula}`));
  return [first, ...others, ...pushed];
}

function offered(score: ShapeScore, value: string, title = scoreText(score)): OfferedScore {
  const { name, direction, range, tolerance, unit } = score;
  return { value, title, scale: { name, direction, lower: range[0], upper: range[1], tolerance, failed: worthOfFailed(score), step: null, unit } };
}

/** What a failed run is worth: the worst end of the range where the problem does not say. */
export function worthOfFailed({ failed, direction, range }: ShapeScore): number {
  return failed ?? (direction === "minimise" ? range[1] : range[0]);
}

/** What changes a number. */
function definition(score: ShapeScore): string {
  return JSON.stringify([score.name, score.formula, score.direction, worthOfFailed(score)]);
}

/** How much better the best is than the baseline, in units of the score; negative if it is worse. */
export function gain(best: number | null | undefined, baseline: number | null | undefined, minimised: boolean): number | null {
  if (best === null || best === undefined || baseline === null || baseline === undefined) return null;
  return minimised ? baseline - best : best - baseline;
}

/** What a gain means: nothing as long as it is within the tolerance. */
export type Change = "better" | "worse" | "equal" | "within";

export const SIGNS: Readonly<Record<Change, string>> = { better: "▲", worse: "▼", equal: "=", within: "≈" };

/** Differences by rounding alone are none. */
const ROUNDING = 1e-9;

export function changeOf(gain: number, tolerance: number): Change {
  if (Math.abs(gain) <= ROUNDING) return "equal";
  if (Math.abs(gain) <= tolerance + ROUNDING) return "within";
  return gain > 0 ? "better" : "worse";
}

/** A gain with its sign. */
export function signed(gain: number, text: string): string {
  return `${gain > 0 ? "+" : gain < 0 ? "−" : ""}${text}`;
}
