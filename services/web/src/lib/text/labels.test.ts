import { expect, test } from "vitest";
import { deletionText, tagsOf, writtenTags } from "./labels";

test("tags are words between spaces or commas, each once", () => {
  expect(writtenTags(" a, b  a,,c ")).toEqual(["a", "b", "c"]);
  expect(writtenTags("")).toEqual([]);
});

test("frequent tags come first", () => {
  expect(tagsOf([{ tags: ["b", "c"] }, { tags: ["c"] }, { tags: ["a"] }])).toEqual([["c", 2], ["a", 1], ["b", 1]]);
});

test("a campaign that stays is named with those that refer to it", () => {
  const referring = ["one", "two", "three", "four"].map((name) => ({ campaign: `${name}${"0".repeat(32)}`, name, use: "rerun of it" }));
  const text = deletionText("mine", { referring });
  expect(text).toContain("mine");
  expect(text).toContain("one0000");
  expect(text).toContain("and 1 more");
});
