import { expect, test } from "vitest";
import { helpAt } from "$lib/forms/fields";

test("a field says what it is for, which names there are, and its limits", () => {
  expect(helpAt("optimizer.population", { type: "integer", minimum: 2, maximum: 100_000 })).toBe("Sets in each iteration. At least 2, at most 100,000.");
  expect(helpAt("x", { description: "Its `own` words.\n\nMore of them.", exclusiveMinimum: 0 })).toBe("Its own words. More than 0.");
  expect(helpAt("catalogue", {}, ["highway"])).toContain("Installed: highway.");
  expect(helpAt("something", { minimum: 0, maximum: 2 ** 63 - 1 })).toBe("At least 0.");
});
