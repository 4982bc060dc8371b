import { expect, test } from "vitest";
import { boxOf, placed, shared, type Label } from "$lib/front/labels";

const WIDE = { left: 54, right: 1200, top: 2, bottom: 390 };
const PHONE = { left: 54, right: 300, top: 2, bottom: 390 };

function overlapping(labels: ReturnType<typeof placed>): string[] {
  const boxes = labels.map((label) => ({ text: label.text, box: boxOf(label) }));
  return boxes.flatMap(({ text, box }, at) => boxes.slice(at + 1).filter((other) => shared(box, other.box) > 0).map((other) => `${text} / ${other.text}`));
}

test("labels lie next to their points and do not hide each other", () => {
  const [first, second] = placed([{ x: 100, y: 100, text: "knee" }, { x: 104, y: 104, text: "baseline" }], WIDE);
  expect([first?.anchor, second?.anchor]).toEqual(["start", "middle"]);
  expect(placed([{ x: 1190, y: 100, text: "best comfort" }], WIDE)[0]?.anchor).toBe("end");
});

test("labels of neighbours on a phone do not overlap, and stay within the chart", () => {
  const words = ["set 1, wins, best discomfort", "set 23, knee", "best energy", "best roll", "baseline"];
  let seed = 7;
  const random = (): number => (seed = (seed * 16807) % 2147483647) / 2147483647;
  for (let round = 0; round < 300; round++) {
    const spread = [12, 60, 240][round % 3] ?? 0;
    const labels = words.map((text): Label => ({ x: 56 + random() * spread, y: 10 + random() * spread, text }));
    const shown = placed(labels, PHONE);
    expect(overlapping(shown)).toEqual([]);
    expect(shown[0]?.text).toBe(words[0]);
    for (const [left, top, right, bottom] of shown.map(boxOf)) expect([left >= PHONE.left, top >= PHONE.top, right <= PHONE.right, bottom <= PHONE.bottom]).toEqual([true, true, true, true]);
  }
});

test("a label without a free place is left out, the later one", () => {
  const crowd = Array.from({ length: 40 }, (_, place): Label => ({ x: 150, y: 100, text: `best objective ${place}` }));
  const shown = placed(crowd, PHONE);
  expect(shown[0]?.text).toBe("best objective 0");
  expect(shown.length).toBeLessThan(crowd.length);
  expect(overlapping(shown)).toEqual([]);
  expect(placed([{ x: 100, y: 100, text: "wider than the chart ".repeat(4) }], PHONE)).toEqual([]);
});
