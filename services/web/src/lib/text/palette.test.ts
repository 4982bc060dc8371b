import { expect, test } from "vitest";
import { found, stepped, type Entry } from "./palette";

const ENTRIES: Entry[] = [
  { title: "Workers", about: "view", href: "#/workers" },
  { title: "highway comfort", about: "campaign, succeeded", words: "abcdef0123", href: "#/campaigns/abcdef0123" },
  { title: "comfort of my car", about: "campaign, running", words: "fedcba", href: "#/campaigns/fedcba" },
];

test("every word has to be found, in the title, the kind or the id; the beginning of a title comes first", () => {
  expect(found(ENTRIES, "comfort").map((entry) => entry.title)).toEqual(["comfort of my car", "highway comfort"]);
  expect(found(ENTRIES, "abcd").map((entry) => entry.title)).toEqual(["highway comfort"]);
  expect(found(ENTRIES, "Campaign RUNNING").map((entry) => entry.title)).toEqual(["comfort of my car"]);
  expect(found(ENTRIES, "comfort workers")).toEqual([]);
});

test("without a word all entries are listed in their order, at most so many", () => {
  expect(found(ENTRIES, " ", 2).map((entry) => entry.title)).toEqual(["Workers", "highway comfort"]);
});

test("steps go on at the other end", () => {
  expect([stepped(0, -1, 3), stepped(2, 1, 3), stepped(0, 1, 0)]).toEqual([2, 0, 0]);
});
