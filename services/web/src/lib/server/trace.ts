/** Time series of an evaluation. They are not stored with runs: the first to ask has the run simulated once more. */

import { ask, get } from "./api";
import type { Reported } from "../charts/series";
import type { Scene } from "../charts/drive";
import type { Trace } from "../charts/geometry";
import type { PendingTrace, ProblemAnswer, ReplayAnswer, SeriesAnswer } from "./types";

const AGAIN_MILLISECONDS = 700;
/** The road and the vehicles of a scenario of drivecal's own planner. */
export function sceneOf(problem: string, scenario: string, signal: AbortSignal): Promise<Scene> {
  return get<Scene>(`/scenarios/${encodeURIComponent(scenario)}?${new URLSearchParams({ problem })}`, signal);
}

export const SIMULATING = "Simulating it once more for its time series …";

/** A drive on a road, or the series that a simulator of the user's own reports. */
export type Series = { trace: Trace } | { reported: Reported; replay: ReplayAnswer | null };

/** The kind of simulator that drives on road networks, and reports replays. */
const ON_ROADS = "highway";

/** Whether a simulation once more shows anything of a run. */
export function isTraced(problem: Pick<ProblemAnswer, "series" | "simulator">): boolean {
  return Object.keys(problem.series).length > 0 || problem.simulator["kind"] === ON_ROADS;
}

/** The series, as soon as they are simulated; `waits` is told what is waited for. Throws a Refusal. */
export async function seriesOf(evaluation: string, signal: AbortSignal, waits: (said: string) => void): Promise<Series> {
  for (;;) {
    const answer = await ask(`/evaluations/${evaluation}/trace`, { signal });
    const body: unknown = await answer.json();
    if (answer.status === 200) return isReported(body) ? { reported: body.series, replay: body.replay ?? null } : { trace: body as Trace };
    const { degraded, state } = body as PendingTrace;
    waits(degraded ?? (state === "queued" ? "Waiting for a worker that simulates it once more …" : SIMULATING));
    await new Promise((resolve) => setTimeout(resolve, AGAIN_MILLISECONDS));
  }
}

const isReported = (body: unknown): body is SeriesAnswer => typeof body === "object" && body !== null && "series" in body;
