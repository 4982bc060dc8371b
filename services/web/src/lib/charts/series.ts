/** Charts of the time series of runs, whatever reports them. */

import { capital, measured } from "../text/format";
import { SERIES } from "./palette";
import type { Series } from "./plot";

export type Reported = Readonly<Record<string, readonly number[]>>;

const TIMES = ["time", "time_s", "t", "t_s"];
const DASHES = [undefined, "6 3"];
const MOST_LINES = 6;

/** The series over which the others are drawn: a time that never goes back. Null if there is none. */
export function timeOf(series: Reported): string | null {
  return TIMES.find((name) => {
    const values = series[name];
    return values !== undefined && values.length > 1 && values.every((value, at) => at === 0 || value >= (values[at - 1] as number));
  }) ?? null;
}

/** Charts of all series, each run over its own time, or over its steps if a series has not the length of the time. A single run has the series of one unit in one chart. */
export function chartsOf(runs: readonly { title: string; colour: string; reported: Reported }[], units: Readonly<Record<string, string>>) {
  const known = runs.map((run) => ({ ...run, time: timeOf(run.reported) }));
  const timeUnit = known.map(({ time }) => units[time ?? ""]).find(Boolean) ?? "s";
  const names = [...new Set(known.flatMap(({ reported, time }) => Object.keys(reported).filter((name) => name !== time && reported[name]?.length)))];
  const single = runs.length === 1;
  const groups: { unit: string; xTitle: string; names: string[]; lines: (Series & { x: readonly number[] })[] }[] = [];
  for (const name of names) {
    const { words, unit } = measured(name, units[name]);
    const drawn = known.filter(({ reported }) => reported[name]?.length);
    const timed = drawn.every(({ reported, time }) => time !== null && reported[time]?.length === reported[name]?.length);
    const xTitle = timed ? `time / ${timeUnit}` : "step";
    const lines = drawn.map(({ title, colour, reported, time }) => {
      const values = reported[name] ?? [];
      return { name: single ? words : title, values, colour, x: timed ? (reported[time ?? ""] ?? []) : values.map((_, at) => at) };
    });
    const group = single && groups.find((entry) => unit !== "" && entry.unit === unit && entry.xTitle === xTitle && entry.lines.length < MOST_LINES && entry.lines[0]?.x.length === lines[0]?.x.length);
    if (group) {
      group.names.push(words);
      group.lines.push(...lines);
    } else groups.push({ unit, xTitle, names: [words], lines });
  }
  return groups.map(({ unit, xTitle, names, lines }) => ({
    title: capital(names.join(", ")),
    xTitle,
    yTitle: unit,
    x: lines.map(({ x }) => x).reduce((longest, x) => (x.length > longest.length ? x : longest)),
    series: lines.map((line, at) => ({ ...line, ...(single ? { colour: SERIES[at] ?? "" } : {}), dash: DASHES[at % DASHES.length] })),
  }));
}
