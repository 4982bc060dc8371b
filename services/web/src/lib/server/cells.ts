/** From a set to the evaluations that it was ranked by. */

import { get } from "./api";
import { go } from "../route.svelte";
import type { Best, CellAnswer, PageSolution } from "./types";

/** Opens the evaluation, with its replay, at a place of the calibration. */
export async function openCell(campaign: string, iteration: number, individual: number, scenario: string): Promise<void> {
  const cell = await get<CellAnswer>(`/campaigns/${campaign}/cell?iteration=${iteration}&individual=${individual}&scenario=${encodeURIComponent(scenario)}`);
  go(["evaluations", String(cell.evaluation)]);
}

/** Sets of the same objective and rating as the best may come before it. */
const MOST = 100;

/** Opens the evaluation of the best set in a scenario; where it is not among the first of the ranking any more, the ranking. */
export async function openBest(campaign: string, best: Best, scenario: string): Promise<void> {
  const { items } = await get<PageSolution>(`/campaigns/${campaign}/solutions?limit=${MOST}`);
  const row = items.find((item) => Object.entries(best.parameters).every(([name, value]) => item.parameters[name] === value));
  if (row) await openCell(campaign, row.iteration, row.individual, scenario);
  else go(["campaigns", campaign, "ranking"]);
}
