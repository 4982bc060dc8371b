/** The road from above at a moment of a replay, as shapes. */

import { onGround } from "./palette";
import type { ReplayAnswer, ReplayVehicle } from "../server/types";
import { at, camera, headingAt, planAt, poseAt, type Pose } from "./geometry";

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
/** Pixels and metres beyond the view at which a line is not followed any more: more than there is between two points of it. */
const BEYOND = 1200;
const BEYOND_METRES = 130;

/** `own`: the colour of one of several ego vehicles. Its plan has it, too: another colour would belong to another vehicle. */
export function colours(dark: boolean, own?: string) {
  const usual = dark
    ? { ground: "#14181d", road: "#2b323b", line: "#dfe5ec", mark: "#8b96a3", ego: "#4db5f5", plan: "#ffa96b", other: "#b9c2cc", glass: "#10151a", way: "#4db5f5", name: "#e8ebef" }
    : { ground: "#e9edf1", road: "#c9d0d8", line: "#ffffff", mark: "#ffffff", ego: "#0072b2", plan: "#d55e00", other: "#5d6874", glass: "#ffffff", way: "#0072b2", name: "#1b2129" };
  if (own === undefined) return usual;
  const ego = onGround(own, dark);
  return { ...usual, ego, way: ego, plan: ego };
}

/** The picture at a moment, from the ground up; the view looks along the road at the ego vehicle. */
export function seen(drive: ReplayAnswer, moment: number, width: number, colour: Colours): Shape[] {
  const scale = Math.max(SMALLEST, width / (AHEAD + BEHIND));
  const ego = poseAt(drive.time_s, drive.ego, moment);
  // By its place along the road: where a road crosses itself, another part of it may be nearer.
  const turn = headingAt(drive.line.map(([along = 0]) => along), drive.line.map((row) => row[3] ?? 0), at(drive.time_s, drive.ego.position_m, moment));
  const look = camera(ego, scale, [width * (BEHIND / (AHEAD + BEHIND)), HEIGHT * 0.56], turn);
  const beyond = Math.max(BEYOND, BEYOND_METRES * scale);
  const visible = ([x, y]: Point): boolean => x > -beyond && x < width + beyond && y > -beyond && y < HEIGHT + beyond;
  const views = (points: readonly (readonly number[])[]): Point[] => points.map(([x = 0, y = 0]) => look(x, y));
  const trail = (xs: readonly number[], ys: readonly number[]): Point[] => views(xs.map((x, index) => [x, ys[index] ?? 0])).filter(visible);

  const shapes: Shape[] = [{ points: [[0, 0], [width, 0], [width, HEIGHT], [0, HEIGHT]], fill: colour.ground }];
  for (const lane of drive.route.lanes) {
    const [right, left] = [views(lane.right), views(lane.left)];
    for (const [from, to] of stretches(right.map((point, index) => visible(point) || visible(left[index] ?? point)))) {
      // The stroke closes the gap to the next lane.
      shapes.push({ points: [...right.slice(from, to), ...left.slice(from, to).reverse()], fill: colour.road, stroke: colour.road, width: 1 });
    }
  }
  for (const line of drive.route.edges) {
    const points = views(line);
    for (const [from, to] of stretches(points.map(visible))) shapes.push({ points: points.slice(from, to), stroke: colour.line, width: 2 });
  }
  for (const line of drive.route.markings) {
    const points = views(line);
    for (const [from, to] of stretches(points.map(visible))) {
      // Dashes stay where they are on the road.
      shapes.push({ points: points.slice(from, to), stroke: colour.mark, width: 1.4, dash: [6 * scale, 12 * scale], dashOffset: length(line.slice(0, from + 1)) * scale });
    }
  }
  shapes.push({ points: trail(drive.ego.x_m, drive.ego.y_m), stroke: colour.way, width: 1.5, opacity: 0.35 });
  const plan = planAt(drive.plans, moment);
  if (plan) shapes.push({ points: trail(plan.x_m, plan.y_m), stroke: colour.plan, width: 3 });

  const car = (vehicle: Pick<ReplayVehicle, "length_m" | "width_m">, pose: Pose, fill: string, name = ""): void => {
    if (Number.isNaN(pose.x)) return;
    const [x, y] = look(pose.x, pose.y);
    if (x < -80 || x > width + 80) return;
    const [long, wide] = [vehicle.length_m * scale, vehicle.width_m * scale];
    const box = (back: number, front: number, side: number): Point[] => [[back, -side], [front, -side], [front, side], [back, side]].map(([a = 0, b = 0]) => turned(x, y, a, b, turn - pose.heading));
    // Round corners: the outline is as wide as the corner is round.
    shapes.push({ points: box(2 - long / 2, long / 2 - 2, wide / 2 - 2), fill, stroke: fill, width: 4 });
    shapes.push({ points: box(long * 0.14, long * 0.26, wide * 0.36), fill: colour.glass, opacity: 0.55 });
    if (name) shapes.push({ text: name, at: [x, y - wide / 2 - 5], colour: colour.name });
  };
  const now = Math.min(Math.max(moment, drive.time_s[0] ?? 0), drive.time_s.at(-1) ?? 0);
  for (const vehicle of drive.others) {
    const times = drive.time_s.slice(vehicle.first, vehicle.first + vehicle.x_m.length);
    if (now >= (times[0] ?? 0) - 1e-9 && now <= (times.at(-1) ?? 0) + 1e-9) car(vehicle, poseAt(times, vehicle, moment), colour.other, vehicle.id);
  }
  car(drive.ego, ego, colour.ego);
  return shapes;
}

/** The places of at least two neighbours that are there, as begin and end of slices. */
function stretches(there: readonly boolean[]): [number, number][] {
  const slices: [number, number][] = [];
  for (let from = 0; from < there.length; ) {
    let to = from;
    while (there[to]) to++;
    if (to - from > 1) slices.push([from, to]);
    from = to + 1;
  }
  return slices;
}

function length(points: readonly (readonly number[])[]): number {
  return points.reduce((metres, [x = 0, y = 0], index) => {
    const [a = x, b = y] = points[index - 1] ?? [];
    return metres + Math.hypot(x - a, y - b);
  }, 0);
}

/** A point of a car, ahead and to the right of its middle, where the car is turned. */
function turned(x: number, y: number, ahead: number, right: number, angle: number): Point {
  return [x + ahead * Math.cos(angle) - right * Math.sin(angle), y + ahead * Math.sin(angle) + right * Math.cos(angle)];
}

/** A path as the `d` of an SVG. */
export function outlineOf({ points, fill }: Path): string {
  return `M${points.map(([x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`).join("L")}${fill ? "Z" : ""}`;
}
