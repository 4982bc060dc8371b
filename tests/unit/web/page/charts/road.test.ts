import { expect, test } from "vitest";
import type { ReplayAnswer } from "$lib/server/types";
import { colours, seen, type Path, type Shape } from "$lib/charts/road";

/** A road of two lanes of 4 and 2.5 m from (0, 0), whose left lane ends after 200 m; at any place in any direction. */
function network(origin: readonly [number, number], heading: number): ReplayAnswer {
  const place = (along: number, left: number): number[] => [
    origin[0] + along * Math.cos(heading) - left * Math.sin(heading),
    origin[1] + along * Math.sin(heading) + left * Math.cos(heading),
  ];
  const line = (left: number, to = 300): number[][] => [0, 50, 100, 150, 200, 250, 300].filter((along) => along <= to).map((along) => place(along, left));
  const driven = (from: number, speed: number, moments: number) => {
    const places = Array.from({ length: moments }, (_, index) => place(from + speed * index, 0));
    return { x_m: places.map(([x = 0]) => x), y_m: places.map(([, y = 0]) => y), heading_rad: places.map(() => heading) };
  };
  return {
    time_s: [0, 1, 2, 3],
    line: [0, 100, 200, 300].map((along) => [along, ...place(along, 0), heading]),
    route: {
      lanes: [{ right: line(-2), left: line(2) }, { right: line(2, 200), left: line(4.5, 200) }],
      edges: [line(-2), line(4.5, 200), [place(200, 2), place(250, 2), place(300, 2)]],
      markings: [line(2, 200)],
    },
    ego: { length_m: 4.7, width_m: 1.9, speed_mps: [30, 30, 30, 30], position_m: [60, 90, 120, 150], offset_m: [0, 0, 0, 0], ...driven(60, 30, 4) },
    others: [{ id: "late", first: 2, length_m: 12, width_m: 2.5, ...driven(140, 20, 2) }],
    plans: [{ made_at_s: 1, time_s: [0, 1, 2], ...driven(90, 30, 3), curvature_1pm: [0, 0, 0], speed_mps: [30, 30, 30], acceleration_mps2: [0, 0, 0] }],
  };
}
const paths = (shapes: Shape[], has: (path: Path) => boolean): Path[] => shapes.filter((shape): shape is Path => "points" in shape && has(shape));
const view = (drive: ReplayAnswer, moment: number): Shape[] => seen(drive, moment, 800, colours(false));
const SCALE = 800 / 155;

test("dashes stay where they are on the road while the view moves", () => {
  const [first, other] = [0, 0.5].map((moment) => paths(view(network([0, 0], 0), moment), ({ dash }) => dash !== undefined)[0]);
  const start = (path: Path | undefined): number => (path?.points[0]?.[0] ?? NaN) - (path?.dashOffset ?? NaN);
  expect(start(first) - start(other)).toBeCloseTo(15 * SCALE);
});

test("a plan is there once it was made", () => {
  const plans = (moment: number): number => paths(view(network([0, 0], 0), moment), ({ stroke }) => stroke === colours(false).plan).length;
  expect([0.5, 1].map(plans)).toEqual([0, 1]);
});

test("lanes have their own widths, borders and ends", () => {
  const shapes = view(network([0, 0], 0), 0);
  const lanes = paths(shapes, ({ fill }) => fill === colours(false).road);
  const widths = lanes.map(({ points }) => Math.abs((points[0]?.[1] ?? 0) - (points.at(-1)?.[1] ?? 0)) / SCALE);
  expect(widths.map((width) => Math.round(10 * width) / 10)).toEqual([4, 2.5]);
  expect(Math.max(...(lanes[1]?.points ?? []).map(([x]) => x)) - Math.max(...(lanes[0]?.points ?? []).map(([x]) => x))).toBeCloseTo(-100 * SCALE);
  const strokes = paths(shapes, ({ fill, stroke }) => fill === undefined && stroke === "#ffffff");
  expect(strokes.map(({ dash }) => dash !== undefined)).toEqual([false, false, false, true]);
});

test("the picture is the same wherever the network lies and whichever way its road leads", () => {
  const known = view(network([0, 0], 0), 1.5);
  for (const [origin, heading] of [[[-4e4, 7e4], 2.5], [[12, -3], -1.2], [[0, 0], Math.PI]] as const) {
    const other = view(network(origin, heading), 1.5);
    expect(other.length).toBe(known.length);
    other.forEach((shape, index) => {
      const same = known[index];
      if (!("points" in shape) || !same || !("points" in same)) return;
      shape.points.forEach(([x, y], place) => {
        expect(x).toBeCloseTo(same.points[place]?.[0] ?? NaN, 5);
        expect(y).toBeCloseTo(same.points[place]?.[1] ?? NaN, 5);
      });
    });
  }
});

test("on a road that crosses itself the view looks along the part that is driven", () => {
  const drive = network([0, 0], 0);
  const across = [-40, -20, 0, 20, 40].map((y) => [1000 + y, 75, y, Math.PI / 2]);
  const crossing = { ...drive, line: [...drive.line, ...across] };
  expect(view(crossing, 0.5)).toEqual(view(drive, 0.5));
});

test("a vehicle is there from its first to its last time", () => {
  const drive = network([0, 0], 0);
  const names = (moment: number): string[] => view(drive, moment).flatMap((shape) => ("text" in shape ? [shape.text] : []));
  expect([1.9, 2, 3].map(names)).toEqual([[], ["late"], ["late"]]);
});

test("a line that leaves the view and comes back is not drawn across it", () => {
  const far = network([0, 0], 0);
  const around = [[0, 0], [100, 0], [200, 0], [1000, 0], [1000, 1000], [0, 1000], [-1000, 0], [-50, 6], [60, 6]];
  const shapes = view({ ...far, route: { lanes: [], edges: [around], markings: [] } }, 0);
  expect(paths(shapes, ({ stroke }) => stroke === "#ffffff").map(({ points }) => points.length)).toEqual([3, 2]);
});

test("a heading that jumps by a whole turn does not turn the vehicle around", () => {
  const drive = network([0, 0], 0);
  const jumping = { ...drive, ego: { ...drive.ego, heading_rad: [3.14, -3.14, -3.14, -3.14] } };
  const lengths = [drive, jumping].map((entry) => {
    const body = paths(view(entry, 0.5), ({ fill }) => fill === colours(false).ego)[0]?.points ?? [];
    return Math.abs((body[0]?.[0] ?? 0) - (body[1]?.[0] ?? 0));
  });
  expect(lengths[1]).toBeCloseTo(lengths[0] ?? NaN, 1);
});
