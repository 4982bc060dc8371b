/** The road from above at a moment of a replay, as shapes: painted on a canvas many times a second, or written as an SVG once. */

import { SERIES, onGround } from "./palette";
import { camera, planAt, poseAt, type Pose, type Trace } from "./geometry";

export interface Scene {
  road: { length_m: number; lanes: number; lane_width_m: number; reference_line: number[][]; boundaries: number[][][] };
  ego: { length_m: number; width_m: number };
  traffic: { id: string; length_m: number; width_m: number }[];
  duration: number;
}

type Point = readonly [number, number];

export interface Path {
  points: Point[];
  fill?: string;
  stroke?: string;
  width?: number;
  dash?: readonly [number, number];
  dashOffset?: number;
  opacity?: number;
}

export interface Label {
  text: string;
  at: Point;
  colour: string;
}

export type Shape = Path | Label;

export type Colours = ReturnType<typeof colours>;

export const HEIGHT = 240;
/** Metres of road that are seen; narrow views see less of it, not smaller cars. */
const AHEAD = 95;
const BEHIND = 60;
const SMALLEST = 4.6;
/** Pixels beyond the view at which a line is not followed any more. */
const BEYOND = 1200;
/** A car with a known place and nothing else. */
const USUAL = { length_m: 4.6, width_m: 1.9 };

/** `own`: the colour of an ego vehicle that is shown beside others. The plan never has it. */
export function colours(dark: boolean, own?: string) {
  const usual = dark
    ? { ground: "#14181d", road: "#2b323b", line: "#dfe5ec", mark: "#8b96a3", ego: "#4db5f5", plan: "#ffa96b", other: "#b9c2cc", glass: "#10151a", way: "#4db5f5", name: "#e8ebef" }
    : { ground: "#e9edf1", road: "#c9d0d8", line: "#ffffff", mark: "#ffffff", ego: "#0072b2", plan: "#d55e00", other: "#5d6874", glass: "#ffffff", way: "#0072b2", name: "#1b2129" };
  if (own === undefined) return usual;
  const ego = onGround(own, dark);
  return { ...usual, ego, way: ego, plan: own === SERIES[1] ? (SERIES[2] as string) : usual.plan };
}

/** The picture at a moment, from the ground up; the view looks along the road at the ego vehicle. */
export function seen(trace: Trace, scene: Scene, moment: number, width: number, colour: Colours): Shape[] {
  const scale = Math.max(SMALLEST, width / (AHEAD + BEHIND));
  const ego = poseAt(trace.time_s, trace.ego, moment);
  const turn = headingOfRoad(scene, ego);
  const look = camera(ego, scale, [width * (BEHIND / (AHEAD + BEHIND)), HEIGHT * 0.56], turn);
  const trail = (points: readonly (readonly number[])[]): Point[] => points.map(([x = 0, y = 0]) => look(x, y)).filter(([x]) => x > -BEYOND && x < width + BEYOND);
  const line = (series: readonly number[], other: readonly number[]): Point[] => trail(series.map((x, index) => [x, other[index] ?? 0]));

  const { boundaries } = scene.road;
  const shapes: Shape[] = [
    { points: [[0, 0], [width, 0], [width, HEIGHT], [0, HEIGHT]], fill: colour.ground },
    { points: [...trail(boundaries[0] ?? []), ...trail(boundaries.at(-1) ?? []).reverse()], fill: colour.road },
  ];
  boundaries.forEach((points, index) => {
    const edge = index === 0 || index === boundaries.length - 1;
    // Dashes stay where they are on the road.
    shapes.push(
      edge
        ? { points: trail(points), stroke: colour.line, width: 2 }
        : { points: trail(points), stroke: colour.mark, width: 1.4, dash: [6 * scale, 12 * scale], dashOffset: begun(points, look, width) * scale },
    );
  });
  shapes.push({ points: line(trace.ego["x_m"] ?? [], trace.ego["y_m"] ?? []), stroke: colour.way, width: 1.5, opacity: 0.35 });
  const plan = planAt(trace.plans, moment);
  if (plan) shapes.push({ points: line(plan.x_m, plan.y_m), stroke: colour.plan, width: 3 });

  const car = (pose: Pose, shape: { length_m: number; width_m: number }, fill: string, name: string): void => {
    if (Number.isNaN(pose.x)) return;
    const [x, y] = look(pose.x, pose.y);
    if (x < -80 || x > width + 80) return;
    const [long, wide] = [shape.length_m * scale, shape.width_m * scale];
    const box = (back: number, front: number, side: number): Point[] => [[back, -side], [front, -side], [front, side], [back, side]].map(([a = 0, b = 0]) => turned(x, y, a, b, turn - pose.heading));
    // Round corners: the outline is as wide as the corner is round.
    shapes.push({ points: box(2 - long / 2, long / 2 - 2, wide / 2 - 2), fill, stroke: fill, width: 4 });
    shapes.push({ points: box(long * 0.14, long * 0.26, wide * 0.36), fill: colour.glass, opacity: 0.55 });
    if (name) shapes.push({ text: name, at: [x, y - wide / 2 - 5], colour: colour.name });
  };
  for (const [name, series] of Object.entries(trace.neighbours)) {
    car(poseAt(trace.time_s, series, moment), scene.traffic.find((entry) => entry.id === name) ?? USUAL, colour.other, name);
  }
  car(ego, scene.ego, colour.ego, "");
  return shapes;
}

/** A point of a car, ahead and to the right of its middle, where the car is turned. */
function turned(x: number, y: number, ahead: number, right: number, angle: number): Point {
  return [x + ahead * Math.cos(angle) - right * Math.sin(angle), y + ahead * Math.sin(angle) + right * Math.cos(angle)];
}

/** The heading of the road where the ego vehicle is. */
function headingOfRoad(scene: Scene, ego: Pose): number {
  let best = 0;
  let nearest = Infinity;
  for (const [, x = 0, y = 0, heading = 0] of scene.road.reference_line) {
    const distance = (x - ego.x) ** 2 + (y - ego.y) ** 2;
    if (distance < nearest) {
      nearest = distance;
      best = heading;
    }
  }
  return best;
}

/** How far along a line, in metres, it begins to be drawn. */
function begun(points: number[][], look: (x: number, y: number) => [number, number], width: number): number {
  let metres = 0;
  for (let index = 0; index < points.length; index++) {
    const [x = 0, y = 0] = points[index] ?? [];
    const [a] = look(x, y);
    if (a > -BEYOND && a < width + BEYOND) return metres;
    const [nextX = x, nextY = y] = points[index + 1] ?? [];
    metres += Math.hypot(nextX - x, nextY - y);
  }
  return 0;
}

export function paint(pen: CanvasRenderingContext2D, shapes: readonly Shape[]): void {
  pen.lineJoin = "round";
  for (const shape of shapes) {
    if ("text" in shape) {
      pen.fillStyle = shape.colour;
      pen.font = "11px sans-serif";
      pen.textAlign = "center";
      pen.fillText(shape.text, ...shape.at);
      continue;
    }
    pen.globalAlpha = shape.opacity ?? 1;
    pen.beginPath();
    shape.points.forEach(([x, y], index) => (index === 0 ? pen.moveTo(x, y) : pen.lineTo(x, y)));
    if (shape.fill) {
      pen.closePath();
      pen.fillStyle = shape.fill;
      pen.fill();
    }
    if (shape.stroke) {
      pen.strokeStyle = shape.stroke;
      pen.lineWidth = shape.width ?? 1;
      pen.setLineDash(shape.dash ?? []);
      pen.lineDashOffset = shape.dashOffset ?? 0;
      pen.stroke();
    }
    pen.globalAlpha = 1;
  }
}

export function svgOf(shapes: readonly Shape[], width: number): string {
  const escaped = (text: string): string => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;");
  const drawn = shapes.map((shape) => {
    if ("text" in shape) return `<text x="${shape.at[0].toFixed(1)}" y="${shape.at[1].toFixed(1)}" fill="${shape.colour}" text-anchor="middle">${escaped(shape.text)}</text>`;
    const points = shape.points.map(([x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`).join("L");
    const stroke = shape.stroke ? ` stroke="${shape.stroke}" stroke-width="${shape.width ?? 1}"` : "";
    const dash = shape.dash ? ` stroke-dasharray="${shape.dash.map((entry) => entry.toFixed(1)).join(" ")}" stroke-dashoffset="${(shape.dashOffset ?? 0).toFixed(1)}"` : "";
    return `<path d="M${points}${shape.fill ? "Z" : ""}" fill="${shape.fill ?? "none"}"${stroke}${dash}${shape.opacity === undefined ? "" : ` opacity="${shape.opacity}"`}/>`;
  });
  return `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${HEIGHT}" viewBox="0 0 ${width} ${HEIGHT}" font-family="sans-serif" font-size="11" stroke-linejoin="round">${drawn.join("")}</svg>`;
}
