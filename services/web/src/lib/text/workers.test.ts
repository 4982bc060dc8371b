import { expect, test } from "vitest";
import { areStarting, nodesOf, storedRuns } from "./workers";

test("workers are listed by node, with the speed of all of them", () => {
  const workers = [
    { id: "w10", node: "b", cells_per_second: 2 },
    { id: "w2", node: "b", cells_per_second: null },
    { id: "w1", node: null, cells_per_second: 3 },
  ];
  expect(nodesOf(workers).map(({ name, workers: own, speed }) => [name, own.map((worker) => worker.id), speed])).toEqual([["b", ["w2", "w10"], 2], ["this machine", ["w1"], 3]]);
});

test("setups that differ in the vehicle's parameters alone share a row of stored runs", () => {
  const setup = (scenario: string, runs: number) => ({ scenario, simulator: "libsumo", driving_function: "frenet", vehicle: "hybrid", runs });
  expect(storedRuns([setup("S1", 1), setup("S2", 9), setup("S1", 4)])).toEqual([
    { scenario: "S2", simulator: "libsumo", drivenBy: "frenet, hybrid", setups: 1, runs: 9 },
    { scenario: "S1", simulator: "libsumo", drivenBy: "frenet, hybrid", setups: 2, runs: 5 },
  ]);
});

test("workers are starting while there are some and none is ready", () => {
  const page = (fresh: boolean, ...states: string[]) => ({ fresh, items: states.map((state) => ({ state })) });
  expect(areStarting(page(true, "starting", "starting"))).toBe(true);
  expect([page(true, "starting", "idle"), page(true), page(false, "starting")].map(areStarting)).toEqual([false, false, false]);
});
