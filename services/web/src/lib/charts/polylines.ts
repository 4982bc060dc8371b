/** Parallel coordinates on a canvas: however many lines there are, no frame takes long. */

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

/** Lines in one frame: adapted to what the browser can paint, so that nothing is ever held up by a hundred thousand of them. */
const FIRST_QUOTA = 250;
const LEAST_QUOTA = 100;
const MOST_QUOTA = 4_000;
/** Milliseconds from one frame to the next. */
const SLOW_FRAME = 40;
/** A frame is slow, too, if it lasts this many times as long as the shortest: the screen was ready, and the lines were not. */
const SLOWER = 1.5;
const FIRST_PASS = 2_000;

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

/** Draws lines frame by frame until they are all there; gives what stops it. `done` is told how many are drawn. */
export function drawLines(
  pen: CanvasRenderingContext2D,
  columns: readonly { axis: Axis; values: Float64Array }[],
  step: number,
  wanted: readonly { rows: Uint32Array; style: string }[],
  done: (count: number) => void,
  stroke: { width: number; dash: number[] } | null = null,
): () => void {
  const scale = columns.map(({ axis }) => (HEIGHT - TOP - BOTTOM) / (axis.upper - axis.lower || 1));
  const total = wanted.reduce((sum, batch) => sum + batch.rows.length, 0);
  // Many lines come in passes, each a sample of all of them: what is seen first is already the whole, only thinner.
  const passes = Math.max(1, Math.ceil(total / FIRST_PASS));
  let pass = 0;
  let part = 0;
  let at = 0;
  let sum = 0;
  let quota = FIRST_QUOTA;
  let last = 0;
  let shortest = Infinity;
  let frame = requestAnimationFrame(function go(now) {
    // Browsers paint after the frame's script has ended: only the time between frames tells what lines cost.
    if (last > 0) {
      const took = now - last;
      shortest = Math.min(shortest, took);
      quota = took > Math.min(SLOW_FRAME, SLOWER * shortest) ? Math.max(LEAST_QUOTA, quota / 2) : Math.min(MOST_QUOTA, quota * 1.3);
    }
    last = now;
    let left = Math.round(quota);
    while (pass < passes && left > 0) {
      const batch = wanted[part];
      if (batch === undefined) {
        pass += 1;
        part = 0;
        at = pass;
        continue;
      }
      pen.strokeStyle = batch.style;
      if (stroke) {
        pen.lineWidth = stroke.width;
        pen.setLineDash(stroke.dash);
      }
      pen.beginPath();
      for (; at < batch.rows.length && left > 0; at += passes) {
        polyline(batch.rows[at] as number);
        left -= 1;
        sum += 1;
      }
      pen.stroke();
      if (at >= batch.rows.length) {
        part += 1;
        at = pass;
      }
    }
    done(sum);
    if (pass < passes) frame = requestAnimationFrame(go);
  });

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
