/** A drive from above, whatever reports it: a trace of the built-in motorway with its scenario, or the replay of a simulator on a road network. */

import type { ReplayAnswer, RoadAnswer, RoadSurface, VehicleAnswer } from "../server/types";
import type { Trace } from "./geometry";

type Sized = Pick<VehicleAnswer, "length_m" | "width_m">;

export interface Scene {
  road: Pick<RoadAnswer, "reference_line" | "boundaries">;
  ego: Sized;
  traffic: (Sized & Pick<VehicleAnswer, "id">)[];
}

export interface Vehicle extends Sized {
  name: string;
  /** The times of its places; it is not there before and after them. */
  time_s: readonly number[];
  /** `x_m`, `y_m` and `heading_rad`. */
  places: Record<string, number[]>;
}

export interface Drive {
  time_s: readonly number[];
  /** Rows of place along the road, x, y and heading. */
  line: readonly (readonly number[])[];
  /** The lanes of the road. */
  surface: RoadSurface;
  ego: Vehicle;
  others: readonly Vehicle[];
  plans: Trace["plans"];
  /** The ego vehicle's speed (m/s), its place along the road and its offset (m). */
  speed: readonly number[];
  along: readonly number[];
  offset: readonly number[];
}

/** A car with a known place and nothing else. */
const USUAL = { length_m: 4.6, width_m: 1.9 };

export function driveOf(trace: Trace, scene: Scene): Drive {
  const { boundaries, reference_line } = scene.road;
  return {
    time_s: trace.time_s,
    line: reference_line,
    surface: {
      lanes: boundaries.slice(1).map((left, index) => ({ right: boundaries[index] ?? [], left })),
      edges: boundaries.length > 1 ? [boundaries[0] ?? [], boundaries.at(-1) ?? []] : [],
      markings: boundaries.slice(1, -1),
    },
    ego: { name: "", ...scene.ego, time_s: trace.time_s, places: trace.ego },
    others: Object.entries(trace.neighbours).map(([name, places]) => {
      const { length_m, width_m } = scene.traffic.find((entry) => entry.id === name) ?? USUAL;
      return { name, length_m, width_m, time_s: trace.time_s, places };
    }),
    plans: trace.plans,
    speed: trace.ego["speed_mps"] ?? [],
    along: trace.ego["s_m"] ?? [],
    offset: trace.ego["d_m"] ?? [],
  };
}

export function driveIn(replay: ReplayAnswer): Drive {
  const { time_s, line } = replay;
  const { length_m, width_m, ...ego } = replay.ego;
  return {
    time_s,
    line,
    surface: replay.route,
    ego: { name: "", length_m, width_m, time_s, places: ego },
    others: replay.others.map(({ id: name, first, length_m, width_m, ...places }) => ({ name, length_m, width_m, time_s: time_s.slice(first, first + places.x_m.length), places })),
    plans: [],
    speed: ego.speed_mps,
    along: ego.position_m,
    offset: ego.offset_m,
  };
}
