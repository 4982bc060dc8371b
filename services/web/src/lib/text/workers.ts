/** Workers by the machine that they run on. */

import type { ReferenceAnswer, WorkerAnswer, WorkerPage } from "../server/types";

type Known = Pick<WorkerAnswer, "id" | "node" | "cells_per_second">;

export interface Node<T> {
  name: string;
  workers: T[];
  /** Cells per second of its workers together. */
  speed: number;
}

/** The nodes by name; workers of none are on this machine. */
export function nodesOf<T extends Known>(workers: readonly T[]): Node<T>[] {
  const names = [...new Set(workers.map((worker) => worker.node ?? "this machine"))].sort();
  return names.map((name) => {
    const own = workers.filter((worker) => (worker.node ?? "this machine") === name).sort((a, b) => a.id.localeCompare(b.id, "en", { numeric: true }));
    return { name, workers: own, speed: own.reduce((sum, worker) => sum + (worker.cells_per_second ?? 0), 0) };
  });
}

/** Whether there are workers and none of them can simulate yet. */
export function areStarting({ fresh, items }: Pick<WorkerPage, "fresh"> & { items: readonly Pick<WorkerAnswer, "state">[] }): boolean {
  return fresh && items.length > 0 && items.every(({ state }) => state === "starting");
}

export interface StoredRuns {
  scenario: string;
  simulator: string;
  drivenBy: string;
  /** Vehicles of robustness studies are setups of their own. */
  setups: number;
  runs: number;
}

/** Stored runs by scenario, simulator and what drives, the most first. */
export function storedRuns(references: readonly Pick<ReferenceAnswer, "scenario" | "simulator" | "driving_function" | "vehicle" | "runs">[]): StoredRuns[] {
  const known = new Map<string, StoredRuns>();
  for (const { scenario, simulator, driving_function: driver, vehicle, runs } of references) {
    const drivenBy = [driver, vehicle].filter(Boolean).join(", ");
    const key = JSON.stringify([scenario, simulator, drivenBy]);
    const row = known.get(key) ?? { scenario, simulator: simulator ?? "", drivenBy, setups: 0, runs: 0 };
    known.set(key, { ...row, setups: row.setups + 1, runs: row.runs + runs });
  }
  return [...known.values()].sort((a, b) => b.runs - a.runs);
}
