/** Places for the labels of a chart's points: no two lie on each other. */

export interface Label {
  x: number;
  y: number;
  text: string;
}

export interface Placed extends Label {
  anchor: "start" | "end" | "middle";
}

export interface Frame {
  left: number;
  right: number;
  top: number;
  bottom: number;
}

/** Left, top, right, bottom. */
type Box = [number, number, number, number];

/** Width of a letter of 12 px, weight 600, at most on average. */
const LETTER = 7.2;
const ABOVE = 11;
const BELOW = 3;
/** Half the width of a point. */
const POINT = 5;
/** Next to the point, then farther and farther away. */
const TRIES = [
  [11, 4, "start"], [-11, 4, "end"], [0, -11, "middle"], [0, 20, "middle"], [9, -9, "start"], [-9, 17, "end"], [9, 17, "start"], [-9, -9, "end"],
  [0, -25, "middle"], [0, 34, "middle"], [9, 34, "start"], [-9, 34, "end"], [9, -25, "start"], [-9, -25, "end"], [9, 48, "start"], [-9, 48, "end"], [0, -39, "middle"],
] as const;

/** The area that a label covers. */
export function boxOf({ x, y, text, anchor }: Placed): Box {
  const wide = LETTER * text.length;
  const left = anchor === "start" ? x : anchor === "end" ? x - wide : x - wide / 2;
  return [left, y - ABOVE, left + wide, y + BELOW];
}

/** The area that two boxes share. */
export function shared(box: Readonly<Box>, other: Readonly<Box>): number {
  return Math.max(0, Math.min(box[2], other[2]) - Math.max(box[0], other[0])) * Math.max(0, Math.min(box[3], other[3]) - Math.max(box[1], other[1]));
}

/** Labels within a frame, in pixels, that hide no other label and as little as possible of the points. The first ones come first; a label without a free place is left out. */
export function placed(labels: readonly Label[], frame: Frame): Placed[] {
  const points = labels.map(({ x, y }): Box => [x - POINT, y - POINT, x + POINT, y + POINT]);
  const taken: Box[] = [];
  const result: Placed[] = [];
  for (const label of labels) {
    const tried = TRIES.map(([dx, dy, anchor]): Placed => ({ text: label.text, x: label.x + dx, y: label.y + dy, anchor }));
    // A wide label in a narrow chart lies above or below its point, moved into the frame.
    const moved = tried.map((place): Placed => {
      const [left, , right] = boxOf(place);
      return { ...place, x: place.x + Math.max(0, frame.left - left) - Math.max(0, right - frame.right) };
    });
    const free = (place: Placed): boolean => {
      const box = boxOf(place);
      return box[0] >= frame.left && box[2] <= frame.right && box[1] >= frame.top && box[3] <= frame.bottom && taken.every((other) => shared(box, other) === 0);
    };
    const hidden = (place: Placed): number => points.reduce((sum, point) => sum + shared(boxOf(place), point), 0);
    const best = (places: readonly Placed[]): Placed | undefined => places.filter(free).reduce<Placed | undefined>((chosen, place) => (chosen && hidden(chosen) <= hidden(place) ? chosen : place), undefined);
    const chosen = best(tried) ?? best(moved);
    if (chosen === undefined) continue;
    taken.push(boxOf(chosen));
    result.push(chosen);
  }
  return result;
}
