/** Parallel coordinates on a canvas. */

export const TOP = 34;
export const BOTTOM = 26;
export const SIDE = 44;
export const HEIGHT = 330;

export interface Axis {
  name: string;
  title: string;
  /** The parameter whose values it has. */
  parameter?: string;
  lower: number;
  upper: number;
  /** What it is. */
  meaning?: string;
  /** Texts at the places 0, 1, 2 and so on. */
  choices?: readonly string[];
}

/** Lines that are drawn of more: a wall of them shows nothing else. */
export const MOST_LINES = 5_000;
const LINES_IN_A_FRAME = 500;

export function heightOf(axis: Axis, value: number): number {
  return TOP + (1 - (value - axis.lower) / (axis.upper - axis.lower || 1)) * (HEIGHT - TOP - BOTTOM);
}

/** The value at a height, at most at an end of the axis. */
export function valueAt(axis: Axis, height: number): number {
  const share = Math.max(0, 1 - (height - TOP) / (HEIGHT - TOP - BOTTOM));
  return share >= 1 ? axis.upper : axis.lower + share * (axis.upper - axis.lower);
}

/** A range of an axis with one of its ends moved by a number of steps within the axis: twentieths, or choices. */
export function moved(axis: Axis, range: readonly [number, number] | undefined, steps: number, end: "lower" | "upper"): [number, number] {
  const [low, high] = range ?? [axis.lower, axis.upper];
  const by = axis.choices ? steps : (steps * (axis.upper - axis.lower)) / 20;
  const within = (value: number): number => Math.min(axis.upper, Math.max(axis.lower, value));
  if (end === "lower") return [Math.min(within(Math.max(low, axis.lower) + by), high), high];
  return [low, Math.max(low, within(Math.min(high, axis.upper) + by))];
}

/** How opaque lines are so that many of them do not become one surface. */
export function opacity(lines: number): number {
  return Math.min(0.9, Math.max(0.03, 12 / Math.sqrt(lines || 1)));
}

/** Draws lines, some in each frame until they are all there; returns what stops it. */
export function drawLines(
  pen: CanvasRenderingContext2D,
  columns: readonly { axis: Axis; values: Float64Array }[],
  step: number,
  wanted: readonly { rows: Uint32Array; style: string }[],
  stroke: { width: number; dash: number[] } | null = null,
): () => void {
  const scale = columns.map(({ axis }) => (HEIGHT - TOP - BOTTOM) / (axis.upper - axis.lower || 1));
  const parts = wanted.flatMap(({ rows, style }) => Array.from({ length: Math.ceil(rows.length / LINES_IN_A_FRAME) }, (_, part) => ({ style, rows: rows.subarray(part * LINES_IN_A_FRAME, (part + 1) * LINES_IN_A_FRAME) })));
  let frame = requestAnimationFrame(draw);
  function draw(): void {
    const part = parts.shift();
    if (part === undefined) return;
    pen.strokeStyle = part.style;
    if (stroke) {
      pen.lineWidth = stroke.width;
      pen.setLineDash(stroke.dash);
    }
    pen.beginPath();
    part.rows.forEach(polyline);
    pen.stroke();
    frame = requestAnimationFrame(draw);
  }

  function polyline(row: number): void {
    let gap = true;
    for (let index = 0; index < columns.length; index++) {
      const { axis, values } = columns[index] as (typeof columns)[number];
      const value = values[row] as number;
      if (Number.isNaN(value)) {
        gap = true;
        continue;
      }
      const height = HEIGHT - BOTTOM - (value - axis.lower) * (scale[index] as number);
      if (gap) pen.moveTo(SIDE + index * step, height);
      else pen.lineTo(SIDE + index * step, height);
      gap = false;
    }
  }
  return () => cancelAnimationFrame(frame);
}
