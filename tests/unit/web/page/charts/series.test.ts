import { expect, test } from "vitest";
import { chartsOf, timeOf } from "$lib/charts/series";

const run = (title: string, reported: Record<string, number[]>) => ({ title, colour: "a", reported });

test("series are drawn over the time that the simulator reports", () => {
  expect(timeOf({ speed: [1, 2], time: [0, 0.1] })).toBe("time");
  expect(timeOf({ t: [0, 2, 1], time_s: [0] })).toBeNull();
});

test("series of one unit of a run share a chart, and every series is on one", () => {
  const series = { time: [0, 1, 2], speed: [10, 20, 15], wanted: [20, 20, 20], gap: [60, 50, 40], travelled: [0, 500, 1000], events: [1, 2], mode: [0, 1, 1] };
  const charts = chartsOf([run("this run", series)], { time: "s", speed: "m/s", wanted: "m/s", gap: "m", travelled: "m" });
  expect(charts.map((chart) => [chart.title, chart.xTitle, chart.yTitle])).toEqual([
    ["Speed, wanted", "time / s", "m/s"],
    ["Gap, travelled", "time / s", "m"],
    ["Events", "step", ""],
    ["Mode", "time / s", ""],
  ]);
  expect(charts[2]?.x).toEqual([0, 1]);
});

test("what runs report is drawn beside each other, each over its own time, in its unit", () => {
  const charts = chartsOf([run("best", { t: [0, 1], speed: [3, 4] }), run("baseline", { t: [0, 0.5, 1], speed: [3, 2, 1], late: [1, 2, 3] })], { t: "ms", speed: "m/s" });
  expect(charts).toMatchObject([
    { xTitle: "time / ms", yTitle: "m/s", x: [0, 0.5, 1], series: [{ name: "best", x: [0, 1] }, { name: "baseline", x: [0, 0.5, 1] }] },
    { title: "Late", series: [{ name: "baseline" }] },
  ]);
  expect(chartsOf([], {})).toEqual([]);
});
