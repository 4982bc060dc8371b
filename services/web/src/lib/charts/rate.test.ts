import { expect, test } from "vitest";
import { Rate } from "./rate";

test("a rate is known after a second, and that of the last seconds", () => {
  const rate = new Rate(10);
  expect(rate.at(0, 100)).toBeNull();
  expect(rate.at(0.5, 150)).toBeNull();
  expect(rate.at(2, 300)).toBe(100);
  for (let second = 3; second <= 40; second++) rate.at(second, 300);
  expect(rate.at(41, 300)).toBe(0);
});

test("a counter that begins anew has no rate", () => {
  const rate = new Rate();
  rate.at(0, 500);
  expect(rate.at(5, 10)).toBeNull();
  expect(rate.at(7, 30)).toBe(10);
});
