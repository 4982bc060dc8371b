/** A run as views show it: its result, and its drive or time series. These are not stored with runs: the first reader has the run simulated once more. */

import { Refusal, ask, get, isUnreached, messageOf } from "./api.svelte";
import type { Reported } from "../charts/series";
import { isDriven, problemOf } from "./shape";
import type { EvaluationDetail, PendingTrace, ProblemAnswer, ReplayAnswer, SeriesAnswer } from "./types";
import type { Outcome } from "../text/words";

const AGAIN_MILLISECONDS = 700;
const SIMULATING = "Simulating it once more for its time series …";
const AWAY = "The server cannot be reached – trying again …";
const READ_ONLY =
  "Time series are not stored with the results: the first view simulates the run again and needs a token with write access. Your token is read-only. " +
  "Open this address with a write token first; the replay is then available to all readers for a day.";

/** The kind of simulator that drives on road networks, and reports replays. */
const ON_ROADS = "highway";

/** Whether the problem's runs are drawn on a road. */
export function replays({ simulator }: Pick<ProblemAnswer, "simulator">): boolean {
  return simulator["kind"] === ON_ROADS;
}

/** The time series of drivecal's own planner that are drawn. */
const DRAWN = ["time_s", "longitudinal_acceleration_mps2", "lateral_acceleration_mps2", "longitudinal_jerk_mps3", "lateral_jerk_mps3", "speed_mps", "d_m"];

type Named<T> = { [K in keyof T as string extends K ? never : K]: T[K] };
type Row = Omit<Named<EvaluationDetail>, "outcome"> & { outcome: Outcome | null };

export class Run {
  row = $state.raw<Row | null>(null);
  problem = $state.raw<ProblemAnswer | null>(null);
  reported = $state.raw<Reported | null>(null);
  drive = $state.raw<ReplayAnswer | null>(null);
  waiting = $state("");
  /** Why there is nothing to draw. */
  untraced = $state("");

  constructor(readonly id: string) {}

  /** Reads what is missing, and the row until it has its answer. Throws a Refusal without a row. */
  async load(signal: AbortSignal): Promise<void> {
    if (!this.row?.outcome) this.row = await get<Row>(`/evaluations/${this.id}`, signal);
    const { campaign, outcome } = this.row;
    this.problem ??= await problemOf(campaign.problem, signal);
    if (Object.keys(this.problem.series).length === 0 && !replays(this.problem)) {
      this.untraced = "The problem declares no time series: its results are the measures.";
    } else if (this.reported === null && outcome !== null) {
      [this.waiting, this.untraced] = [SIMULATING, ""];
      try {
        await this.simulate(isDriven(this.problem), signal);
        this.waiting = "";
      } catch (error) {
        if (signal.aborted) throw error;
        this.waiting = isUnreached(error) ? AWAY : "";
        if (!isUnreached(error)) this.untraced = error instanceof Refusal && error.status === 403 ? READ_ONLY : messageOf(error);
      }
    }
  }

  private async simulate(driven: boolean, signal: AbortSignal): Promise<void> {
    for (;;) {
      const answer = await ask(`/evaluations/${this.id}/trace`, { signal });
      const body = (await answer.json()) as PendingTrace | SeriesAnswer;
      if ("series" in body) {
        this.reported = driven ? Object.fromEntries(DRAWN.map((name) => [name === "d_m" ? "offset from the rightmost lane's centre_m" : name, body.series[name] ?? []])) : body.series;
        this.drive = body.replay ?? null;
        if (this.drive === null && Object.keys(body.series).length === 0) this.untraced = "The run ended before it had any time series.";
        return;
      }
      this.waiting = body.degraded ?? (body.state === "queued" ? "Waiting for a worker that simulates it once more …" : SIMULATING);
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MILLISECONDS));
    }
  }
}
