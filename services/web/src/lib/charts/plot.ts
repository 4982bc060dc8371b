/** Where the marks of a chart lie: scales, ticks and paths, in pixels from the upper left corner. */

import type { Sheet } from "../server/columns";
import { nearestTo, ticks } from "./geometry";

export interface Series {
  name: string;
  values: readonly (number | null)[];
  colour: string;
  dash?: string;
  kind?: "line" | "area" | "bar";
  /** Its own places, if they differ from the chart's. */
  x?: readonly number[];
  /** Series of one group have one entry in the legend. */
  group?: string;
  /** Holds each value until the next place. */
  steps?: boolean;
  /** Offset of its line in pixels, so that lines of equal value do not hide each other. */
  shift?: number;
}

export interface Frame {
  width: number;
  height: number;
  left: number;
  right: number;
  top: number;
  bottom: number;
  x: readonly [number, number];
  y: readonly [number, number];
  log: boolean;
}

interface Scales {
  px: (value: number) => number;
  py: (value: number) => number;
  /** From pixels to values, on linear scales. */
  x: (pixel: number) => number;
  y: (pixel: number) => number;
}

/** Between values and pixels. On a logarithmic scale everything below the lower end lies at it, zero as well. */
export function scales(frame: Frame): Scales {
  const [x0, x1] = frame.x;
  const [y0, y1] = frame.log ? [Math.log10(frame.y[0]), Math.log10(frame.y[1])] : frame.y;
  const across = (frame.width - frame.left - frame.right) / (x1 - x0 || 1);
  const up = (frame.height - frame.top - frame.bottom) / (y1 - y0 || 1);
  const height = (value: number): number => (frame.log ? Math.log10(Math.max(value, frame.y[0])) : value);
  return {
    px: (value) => frame.left + (value - x0) * across,
    py: (value) => frame.height - frame.bottom - (height(value) - y0) * up,
    x: (pixel) => x0 + (pixel - frame.left) / across,
    y: (pixel) => y0 + (frame.height - frame.bottom - pixel) / up,
  };
}

/** The base of each value, if areas and bars are stacked. */
export function floors(series: readonly Series[], length: number, stacked: boolean): number[][] {
  const base = Array.from({ length }, () => 0);
  return series.map((line) => {
    const floor = [...base];
    if (stacked) line.values.forEach((value, index) => (base[index] = (base[index] ?? 0) + (value ?? 0)));
    return floor;
  });
}

/** The vertical range that holds everything on a chart. */
export function reach(series: readonly Series[], below: readonly (readonly number[])[], log: boolean): [number, number] {
  let low = Infinity;
  let high = -Infinity;
  series.forEach((line, which) =>
    line.values.forEach((value, index) => {
      if (value === null || Number.isNaN(value)) return;
      const floor = below[which]?.[index] ?? 0;
      high = Math.max(high, floor + value);
      low = Math.min(low, floor + value, isLine(line) ? Infinity : floor);
    }),
  );
  if (log) return [0.7, Math.max(10, 1.6 * high)];
  if (low > high) return [0, 1];
  const margin = high > low ? (high - low) * 0.06 : 0.5;
  return [series.every(isLine) ? low - margin : Math.min(0, low), high + margin];
}

export function isLine(line: Series): boolean {
  return line.kind === undefined || line.kind === "line";
}

/** The range of the places of all series; `half`: half a bar's width. */
export function across(x: readonly number[], series: readonly Series[], half: number): [number, number] {
  let low = Infinity;
  let high = -Infinity;
  for (const places of [x, ...series.map((line) => line.x ?? [])]) {
    for (const place of places) {
      if (place < low) low = place;
      if (place > high) high = place;
    }
  }
  if (low > high) return [0, 1];
  const room = low === high ? Math.max(half, 0.5) : half; // a single place stands in the middle
  return [low - room, high + room];
}

/** Powers of ten, with numbers between them if there are few. */
export function logTicks(low: number, high: number): number[] {
  const powers: number[] = [];
  for (let power = Math.ceil(Math.log10(low) - 1e-9); power <= Math.log10(high) + 1e-9; power++) powers.push(10 ** power);
  const between = powers.length > 2 ? [1] : [1, 2, 5];
  return powers.flatMap((power) => between.map((factor) => factor * power)).filter((tick) => tick <= high);
}

/** `whole`: counts have no marks between whole numbers. */
export function ticksOf(frame: Frame, about: number, whole = false): number[] {
  if (frame.log) return logTicks(frame.y[0], frame.y[1]);
  return ticks(frame.y[0], frame.y[1], about).filter((tick) => !whole || Number.isInteger(tick));
}

/** Pixels to both sides of a single value, which would not be seen otherwise. */
const MARK = 7;

/** The outline of a line or an area, as the `d` of an SVG path. */
export function outline(line: Series, x: readonly number[], floor: readonly number[], stacked: boolean, frame: Frame): string {
  const { px, py } = scales(frame);
  const places = line.x ?? x;
  const points: string[] = [];
  const back: string[] = [];
  let before: string | null = null;
  line.values.forEach((value, index) => {
    if (value === null || Number.isNaN(value)) return;
    const bottom = stacked ? (floor[index] ?? 0) : 0;
    const at = px(places[index] ?? 0).toFixed(1);
    const height = (py(bottom + value) + (line.shift ?? 0)).toFixed(1);
    if (line.steps && before !== null) points.push(`${at} ${before}`);
    points.push(`${at} ${height}`);
    back.push(`${at} ${py(bottom).toFixed(1)}`);
    before = height;
  });
  if (points.length === 0) return "";
  if (points.length === 1) {
    const widened = (point: string): string[] => [-MARK, MARK].map((by) => { const [at = "", height = ""] = point.split(" "); return `${(Number(at) + by).toFixed(1)} ${height}`; });
    points.splice(0, 1, ...widened(points[0] as string));
    back.splice(0, 1, ...widened(back[0] as string));
  }
  return line.kind === "area" ? `M${points.join("L")}L${back.reverse().join("L")}Z` : `M${points.join("L")}`;
}

/** Whether counts are so unlike that the large ones would hide the small ones. */
export function spansDecades(counts: readonly number[]): boolean {
  const seen = counts.filter((count) => count > 0);
  return seen.length > 1 && Math.max(...seen) > 50 * Math.min(...seen);
}

/** The value of a line near a moment; null outside of places of its own. */
export function valueNear(line: Series, x: readonly number[], moment: number): number | null {
  const at = nearestTo(line.x ?? x, moment);
  const isOutside = line.x !== undefined && (moment < (line.x[0] ?? 0) || moment > (line.x.at(-1) ?? 0));
  return at === null || isOutside ? null : (line.values[at] ?? null);
}

/** The numbers of a chart: a row for each place, or for each value of each line if lines have places of their own. */
export function numbersOf(series: readonly Series[], x: readonly number[], xTitle: string, yTitle: string): Sheet {
  if (series.every((line) => line.x === undefined)) return { head: [xTitle, ...series.map((line) => line.name)], rows: x.map((value, at) => [value, ...series.map((line) => line.values[at] ?? null)]) };
  return { head: ["line", xTitle, yTitle], rows: series.flatMap((line) => line.values.map((value, at) => [line.name, (line.x ?? x)[at] ?? null, value])) };
}

/** What the legend lists: each group once. */
export function legend(series: readonly Series[]): Series[] {
  const known = new Set<string>();
  return series.filter((line) => {
    const name = line.group ?? line.name;
    if (known.has(name)) return false;
    known.add(name);
    return true;
  });
}
