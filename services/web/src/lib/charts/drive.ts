/** A drive from above: the replay of a run on a road network. */

import type { ReplayAnswer, ReplayVehicle, RoadSurface } from "../server/types";

export interface Vehicle extends Pick<ReplayVehicle, "length_m" | "width_m"> {
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
  plans: ReplayAnswer["plans"];
  /** The ego vehicle's speed (m/s), its place along the road and its offset (m). */
  speed: readonly number[];
  along: readonly number[];
  offset: readonly number[];
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
    plans: replay.plans,
    speed: ego.speed_mps,
    along: ego.position_m,
    offset: ego.offset_m,
  };
}
