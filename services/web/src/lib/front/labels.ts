/** Places for the labels of a chart's points: no two lie on each other. */

export interface Label {
  x: number;
  y: number;
  text: string;
}

export interface Placed extends Label {
  anchor: "start" | "end" | "middle";
}

type Frame = Pick<DOMRect, "left" | "right" | "top" | "bottom">;

/** Left, top, right, bottom. */
type Box = [number, number, number, number];

/** Width of a letter of 12 px, weight 600, at most on average. */
const LETTER = 7.2;
const ABOVE = 11;
const BELOW = 3;
/** Next to the point, then farther and farther away. */
const TRIES = [[11, 4, "start"], [-11, 4, "end"], [0, -11, "middle"], [0, 20, "middle"], [9, -25, "start"], [-9, -25, "end"], [9, 34, "start"], [-9, 34, "end"], [0, 48, "middle"], [0, -39, "middle"]] as const;

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

/** Labels within a frame, in pixels, that hide no other label. The first ones come first; a label without a free place is left out. */
export function placed(labels: readonly Label[], frame: Frame): Placed[] {
  const result: Placed[] = [];
  for (const { x, y, text } of labels) {
    const tried = TRIES.map(([dx, dy, anchor]): Placed => ({ text, x: x + dx, y: y + dy, anchor }));
    // A wide label in a narrow chart is moved into the frame.
    const moved = tried.map((place): Placed => {
      const [left, , right] = boxOf(place);
      return { ...place, x: place.x + Math.max(0, frame.left - left) - Math.max(0, right - frame.right) };
    });
    const free = [...tried, ...moved].find((place) => {
      const box = boxOf(place);
      const within = box[0] >= frame.left && box[2] <= frame.right && box[1] >= frame.top && box[3] <= frame.bottom;
      return within && result.every((other) => shared(box, boxOf(other)) === 0);
    });
    if (free) result.push(free);
  }
  return result;
}
