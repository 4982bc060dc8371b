/** Charts of the time series that a simulator reports, whatever they are. */

import type { Trace } from "./geometry";
import { SERIES } from "./palette";
import type { Series } from "./plot";

export type Reported = Readonly<Record<string, readonly number[]>>;

export interface SeriesChart {
  title: string;
  xTitle: string;
  yTitle: string;
  x: readonly number[];
  series: Series[];
  range?: [number, number];
}

const TIMES = ["time", "time_s", "t", "t_s"];
const MOST_LINES = 6;
/** Charts of two runs. */
const MOST_CHARTS = 6;

/** The series over which the others are drawn: a time that never goes back. Null if there is none. */
export function timeOf(series: Reported): string | null {
  return TIMES.find((name) => {
    const values = series[name];
    return values !== undefined && values.length > 1 && values.every((value, at) => at === 0 || value >= (values[at - 1] as number));
  }) ?? null;
}

/** Charts of all series in their order, of one unit in one chart; series that have not the length of the time are drawn by their steps. */
export function chartsOf(series: Reported, units: Readonly<Record<string, string>>): SeriesChart[] {
  const time = timeOf(series);
  const times = time === null ? [] : (series[time] ?? []);
  const groups: { unit: string; timed: boolean; names: string[] }[] = [];
  for (const [name, values] of Object.entries(series)) {
    if (name === time || values.length === 0) continue;
    const unit = units[name] ?? "1";
    const timed = time !== null && values.length === times.length;
    const group = groups.find((entry) => unit !== "1" && entry.unit === unit && entry.timed === timed && entry.names.length < MOST_LINES && (timed || series[entry.names[0] ?? ""]?.length === values.length));
    if (group) group.names.push(name);
    else groups.push({ unit, timed, names: [name] });
  }
  return groups.map(({ unit, timed, names }) => ({
    title: names.map((name) => name.replaceAll("_", " ")).join(", "),
    xTitle: timed && time !== null ? `time / ${units[time] ?? "s"}` : "step",
    yTitle: unit === "1" ? "" : unit,
    x: timed ? times : (series[names[0] ?? ""] ?? []).map((_, at) => at),
    series: names.map((name, at) => ({ name: name.replaceAll("_", " "), values: series[name] ?? [], colour: SERIES[at] ?? "", ...(at % 2 === 1 ? { dash: "6 3" } : {}) })),
  }));
}

/** A chart of one quantity of several runs, each with times of its own. */
export function beside(title: string, unit: string, runs: readonly { name: string; colour: string; x: readonly number[]; values: readonly number[] }[], timeUnit = "s"): SeriesChart {
  const x = runs.reduce<readonly number[]>((longest, run) => (run.x.length > longest.length ? run.x : longest), []);
  return {
    title,
    xTitle: `time / ${timeUnit}`,
    yTitle: unit,
    x,
    series: runs.map((run, place) => ({ name: run.name, values: run.values, colour: run.colour, x: run.x, ...(place === 0 ? {} : { dash: "6 3" }) })),
  };
}

const QUANTITIES = [
  ["Longitudinal acceleration", "longitudinal_acceleration_mps2", "m/s²"], ["Lateral acceleration", "lateral_acceleration_mps2", "m/s²"], ["Longitudinal jerk", "longitudinal_jerk_mps3", "m/s³"],
  ["Lateral jerk", "lateral_jerk_mps3", "m/s³"], ["Speed", "speed_mps", "m/s"], ["Offset from the rightmost lane's centre", "d_m", "m"],
] as const;

/** Charts of drives of the built-in planner. */
export function drivesBeside(runs: readonly { title: string; colour: string; trace: Trace }[]): SeriesChart[] {
  return QUANTITIES.map(([title, field, unit]) => {
    const chart = beside(title, unit, runs.map(({ title: name, colour, trace }) => ({ name, colour, x: trace.time_s, values: trace.ego[field] ?? [] })));
    return field === "d_m" ? { ...chart, range: roomy(chart.series.flatMap((line) => line.values as readonly number[])) } : chart;
  });
}

/** At least a metre: centimetres shall not look like a lane change. */
function roomy(values: readonly number[]): [number, number] {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const margin = Math.max(0.06 * (high - low), (1 - (high - low)) / 2);
  return [low - margin, high + margin];
}

/** Charts of what several runs report, each over its own time; `left` says what is not drawn. */
export function reportsBeside(runs: readonly { title: string; colour: string; reported: Reported }[], units: Readonly<Record<string, string>>): { charts: SeriesChart[]; left: string } {
  const times = runs.map(({ reported }) => timeOf(reported));
  const time = times.find((name) => name !== null) ?? null;
  const names = [...new Set(runs.flatMap(({ reported }) => Object.keys(reported)))].filter((name) => !times.includes(name));
  if (time === null) return { charts: [], left: names.length === 0 ? "" : `The series are not drawn beside each other: none of them is a time (${TIMES.join(", ")}). The evaluations draw them by their steps.` };
  const timed = names.flatMap((name): SeriesChart[] => {
    const drawn = runs.flatMap(({ title, colour, reported }, place) => {
      const [x, values] = [reported[times[place] ?? ""] ?? [], reported[name] ?? []];
      return x.length > 0 && values.length === x.length ? [{ name: title, colour, x, values }] : [];
    });
    return drawn.length === 0 ? [] : [beside(name.replaceAll("_", " "), units[name] ?? "", drawn, units[time])];
  });
  const charts = timed.slice(0, MOST_CHARTS);
  return { charts, left: names.length === charts.length ? "" : `${charts.length} of ${names.length} series are drawn${timed.length < names.length ? `; ${names.length - timed.length} have not the length of the time` : ""}. The evaluations draw all of them.` };
}
