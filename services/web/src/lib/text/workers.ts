/** Workers by the machine that they run on. */

import type { WorkerAnswer } from "../server/types";

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
