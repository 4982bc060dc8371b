/** Curves and maps: values at the support points of a set, as lines of a chart. */

import type { ShapeAnswer } from "../server/types";
import { unitText } from "../text/format";
import { SERIES } from "./palette";
import type { Series } from "./plot";

type Values = Readonly<Record<string, number | string>>;
type Rows = readonly (readonly number[])[];

/** The values of a set: a row for each support point of x, with a value for each of y; a curve has a single row. */
export function rowsOf(shape: ShapeAnswer, parameters: Values): number[][] {
  const given = shape.names.map((name) => Number(parameters[name]));
  const [along = [], across = []] = shape.weights.length === 1 ? [[[1]], ...shape.weights] : shape.weights; // a curve is a map of one row
  const width = across[0]?.length ?? 1;
  const rows = Array.from({ length: given.length / width }, (_, row) => weighed(across, given.slice(row * width, (row + 1) * width)));
  return along.map((weights) => across.map((_, column) => rounded(sum(weights, rows.map((row) => row[column] ?? 0)), shape)));
}

const sum = (weights: readonly number[], values: readonly number[]): number => weights.reduce((total, weight, at) => total + weight * (values[at] ?? 0), 0);
const weighed = (weights: Rows, values: readonly number[]): number[] => weights.map((row) => sum(row, values));

function rounded(value: number, { lower, upper, step }: ShapeAnswer): number {
  const inside = Math.min(upper, Math.max(lower, value));
  const steps = step === null ? 0 : (inside - lower) / step;
  const whole = Math.abs(steps % 1) === 0.5 ? 2 * Math.round(steps / 2) : Math.round(steps); // to even, as the simulator gets it
  return Number((step === null ? inside : lower + whole * step).toFixed(9));
}

/** A chart with the lines of a set, the lines of another set, and the range of good sets. */
export function chartOf(name: string, shape: ShapeAnswer, parameters: Values, other: Values | null, beside: string) {
  const rows = rowsOf(shape, parameters);
  const isMap = rows.length > 1;
  const [first = [], second] = shape.axes;
  const unit = (at: number): string => unitText(shape.axis_units[at] ?? "1");
  const label = (row: number): string => (isMap ? `x = ${first[row] ?? ""}${unit(0) ? ` ${unit(0)}` : ""}` : "this set");
  const lines: Series[] = rows.map((values, row) => ({ name: label(row), values, colour: SERIES[row % SERIES.length] ?? "" }));
  if (other !== null) rowsOf(shape, other).forEach((values, row) => lines.push({ name: isMap ? `${beside}, ${label(row)}` : beside, values, colour: "#7f7f7f", dash: "6 4", ...(isMap ? { group: beside } : {}) }));
  const good = shape.good;
  if (good !== null && good.sets > 1) {
    const group = `range of ${good.sets} good sets`;
    for (const [end, ends] of [["lowest", good.lower], ["highest", good.upper]] as const) (isMap ? (ends as number[][]) : [ends as number[]]).forEach((values, row) => lines.push({ name: `${end} of ${good.sets} good sets${isMap ? `, ${label(row)}` : ""}`, values, colour: isMap ? (SERIES[row % SERIES.length] ?? "") : "#009e73", dash: "2 3", group }));
  }
  const axis = second ?? first;
  const of = unitText(shape.unit);
  return { title: name, x: axis, series: lines, xTitle: [isMap ? "y" : "axis", unit(isMap ? 1 : 0)].filter(Boolean).join(", "), yTitle: [name, of].filter(Boolean).join(", ") };
}

/** A chart with the lines and good sets of several sets, each in the colour of its place; null without any. Other axes than the first set's are left out. */
export function overlaid(name: string, sets: readonly { title: string; shape: ShapeAnswer | undefined; parameters: Values | undefined }[]) {
  const charts = sets.flatMap(({ title, shape, parameters }, place) => (shape && parameters ? [{ title, colour: SERIES[place] ?? "", axes: JSON.stringify(shape.axes), chart: chartOf(name, shape, parameters, null, "") }] : []));
  const first = charts[0];
  if (first === undefined) return null;
  const series = charts.filter(({ axes }) => axes === first.axes).flatMap(({ title, colour, chart }) => chart.series.map((line) => ({ ...line, name: line.name === "this set" ? title : `${title}, ${line.name}`, colour, group: line.dash ? `good sets of ${title}` : title })));
  return { ...first.chart, series };
}
