import { expect, test } from "vitest";
import { addressFor, generalAddress } from "./views";

test("a view for all campaigns opens in another one, without the row that was chosen", () => {
  const general = generalAddress("#/campaigns/abc/ranking?chart=map&row=7&b.P1=0%3A1", "abc");
  expect(general).toBe("#/campaigns/*/ranking?chart=map&b.P1=0%3A1");
  expect(addressFor(general, "def")).toBe("#/campaigns/def/ranking?chart=map&b.P1=0%3A1");
  expect(addressFor(generalAddress("#/campaigns/abc", "abc"), "def")).toBe("#/campaigns/def");
});

test("a view of one campaign stays as it is", () => {
  expect(addressFor("#/campaigns/abc/ranking", "def")).toBe("#/campaigns/abc/ranking");
  expect(addressFor("#/workers", "def")).toBe("#/workers");
});
