import { expect, test } from "vitest";
import { OUTCOMES } from "../text/words";
import { COLOURS } from "./palette";

/** What red-green blind eyes see of linear light (Viénot, Brettel and Mollon, 1999). */
const SEEN: Record<string, readonly (readonly number[])[]> = {
  normal: [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
  protanopia: [[0.1124, 0.8876, 0], [0.1124, 0.8876, 0], [0.004, -0.004, 1]],
  deuteranopia: [[0.2927, 0.7073, 0], [0.2927, 0.7073, 0], [-0.0223, 0.0223, 1]],
};

function linear(colour: string): number[] {
  return [1, 3, 5].map((at) => {
    const share = Number.parseInt(colour.slice(at, at + 2), 16) / 255;
    return share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4;
  });
}

/** CIE Lab of linear sRGB. */
function lab(light: readonly number[]): [number, number, number] {
  const [r = 0, g = 0, b = 0] = light;
  const f = (value: number): number => (value > 0.008856 ? Math.cbrt(value) : 7.787 * value + 16 / 116);
  const x = f((0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505);
  const y = f(0.2126 * r + 0.7152 * g + 0.0722 * b);
  const z = f((0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.089);
  return [116 * y - 16, 500 * (x - y), 200 * (y - z)];
}

test.each(Object.entries(SEEN))("colours of outcomes differ to eyes of %s", (_, matrix) => {
  const seen = OUTCOMES.map((outcome) => lab(matrix.map((row) => row.reduce((sum, weight, place) => sum + weight * (linear(COLOURS[outcome])[place] ?? 0), 0))));
  for (const [place, first] of seen.entries()) {
    for (const other of seen.slice(0, place)) expect(Math.hypot(...first.map((value, axis) => value - (other[axis] ?? 0)))).toBeGreaterThan(10);
  }
});
