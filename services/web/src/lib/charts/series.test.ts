import { expect, test } from "vitest";
import { chartsOf, reportsBeside, timeOf } from "./series";

test("series are drawn over the time that the simulator reports", () => {
  expect(timeOf({ speed: [1, 2], time: [0, 0.1] })).toBe("time");
  expect(timeOf({ t: [0, 2, 1], time_s: [0] })).toBeNull();
});

test("series of one unit share a chart, and every series is on one", () => {
  const series = { time: [0, 1, 2], speed: [10, 20, 15], wanted: [20, 20, 20], gap: [60, 50, 40], travelled: [0, 500, 1000], events: [1, 2], mode: [0, 1, 1] };
  const charts = chartsOf(series, { time: "s", speed: "m/s", wanted: "m/s", gap: "m", travelled: "m" });
  expect(charts.map((chart) => [chart.title, chart.xTitle, chart.yTitle])).toEqual([
    ["speed, wanted", "time / s", "m/s"],
    ["gap, travelled", "time / s", "m"],
    ["events", "step", ""],
    ["mode", "time / s", ""],
  ]);
  expect(charts[2]?.x).toEqual([0, 1]);
});

const run = (title: string, reported: Record<string, number[]>) => ({ title, colour: "a", reported });

test("what runs report is drawn beside each other, each over its own time, in its unit", () => {
  const { charts, left } = reportsBeside([run("best", { t: [0, 1], speed: [3, 4] }), run("baseline", { t: [0, 0.5, 1], speed: [3, 2, 1] })], { t: "ms", speed: "m/s" });
  expect(charts).toMatchObject([{ xTitle: "time / ms", yTitle: "m/s", x: [0, 0.5, 1], series: [{ name: "best", x: [0, 1] }, { name: "baseline", x: [0, 0.5, 1] }] }]);
  expect(left).toBe("");
});

test("what is not drawn beside each other is counted, with its reason", () => {
  const many = Object.fromEntries(Array.from({ length: 8 }, (_, place) => [`v${place}`, [1, 2]]));
  const long = reportsBeside([run("best", { time: [0, 1], ...many, events: [1, 2, 3] })], {});
  expect([long.charts.length, long.charts.some(({ title }) => title === "events")]).toEqual([6, false]);
  expect(long.left).toMatch(/^6 of 9 series are drawn; 1 have/);
  const untimed = reportsBeside([run("best", { speed: [1, 2] })], {});
  expect(untimed.charts).toEqual([]);
  expect(untimed.left).toContain("time_s");
  expect(reportsBeside([], {})).toEqual({ charts: [], left: "" });
});
