import { expect, test } from "vitest";
import { BUILT_IN, aboutSection, beginAt, choicesAt, helpAt } from "./fields";

test("a field says what it is for, which names there are, and its limits", () => {
  expect(helpAt("optimizer.population", { type: "integer", minimum: 2, maximum: 100_000 })).toBe("Sets in each iteration. At least 2, at most 100,000.");
  expect(helpAt("x", { description: "Its `own` words.\n\nMore of them.", exclusiveMinimum: 0 })).toBe("Its own words. More than 0.");
  expect(helpAt("catalogue", {}, ["highway"])).toContain("Installed: highway.");
  expect(helpAt("something", { minimum: 0, maximum: 2 ** 63 - 1 })).toBe("At least 0.");
});

test("a form explains what predictions need", () => {
  for (const name of ["mode", "tolerance", "limit"]) expect(helpAt(`reduction.${name}`, {})).not.toBe("");
});

test("names can be chosen wherever in a list a field stands", () => {
  expect(choicesAt(BUILT_IN, "optimizers[2].kind")).toContain("swarm");
  expect(choicesAt(BUILT_IN, "name")).toEqual([]);
});

test("a quantile begins with a share", () => {
  expect([beginAt("objectives[2].aggregate"), beginAt("sensitivity.threshold")]).toEqual([{ quantile: 0.9 }, {}]);
});

test("a section is described without references to the paper", () => {
  expect(aboutSection("Robustness against `other` vehicles (Sections II-C and IV-D).\n\nMore.")).toBe("Robustness against other vehicles.");
});
