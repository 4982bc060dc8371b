import { expect, test } from "vitest";
import { nodesOf } from "./workers";

test("workers are listed by node, with the speed of all of them", () => {
  const workers = [
    { id: "w10", node: "b", cells_per_second: 2 },
    { id: "w2", node: "b", cells_per_second: null },
    { id: "w1", node: null, cells_per_second: 3 },
  ];
  expect(nodesOf(workers).map(({ name, workers: own, speed }) => [name, own.map((worker) => worker.id), speed])).toEqual([["b", ["w2", "w10"], 2], ["this machine", ["w1"], 3]]);
});
