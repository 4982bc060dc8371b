import { afterEach, describe, expect, test, vi } from "vitest";
import { ago, clock, duration, measured, number, percent, rounded, scored } from "$lib/text/format";

test("a part is never rounded to nothing, nor to the whole", () => {
  expect(percent(0)).toBe("0.0 %");
  expect(percent(0.00001)).toBe("< 0.1 %");
  expect(percent(0.315)).toBe("31.5 %");
  expect(percent(0.99999)).toBe("> 99.9 %");
  expect(percent(1)).toBe("100.0 %");
  expect(percent(null)).toBe("–");
});

test("a measure's unit is apart from its name, declared or at its end", () => {
  expect(measured("peak_lateral_jerk_mps3")).toEqual({ words: "peak lateral jerk", unit: "m/s³" });
  expect(measured("energy_kwh", "kWh")).toEqual({ words: "energy kwh", unit: "kWh" });
  expect(measured("min_gap_m", "m")).toEqual({ words: "min gap", unit: "m" });
  expect(measured("motion_mps15")).toEqual({ words: "motion", unit: "m/s¹·⁵" });
  expect(measured("heave", "1")).toEqual({ words: "heave", unit: "" });
  expect(measured("count_s", "1")).toEqual({ words: "count s", unit: "" });
  expect([measured("s"), measured("lane_changes")]).toEqual([{ words: "s", unit: "" }, { words: "lane changes", unit: "" }]);
});

test("numbers have the decimals that they need", () => {
  expect([number(7), number(0.5), number(1 / 3), number(12_345), number(null), number(Number.NaN)]).toEqual(["7", "0.5", "0.333", "12,345", "–", "–"]);
});

test("small numbers keep their digits, and what rounding leaves is nothing", () => {
  expect([number(0.000_43), number(-0.000_000_012), number(0.05), number(3e-17), number(0.1 + 0.2), number(1e-12), number(100 * 1.1 - 110), number(1e300)]).toEqual(["0.00043", "-1.2e-8", "0.05", "0", "0.3", "1e-12", "0", "1e+300"]);
});

test("a score has the unit of its scale, and points need none", () => {
  expect([scored(2.5, { unit: "EUR" }), scored(5, { unit: "points" }), scored(null, { unit: "EUR" }), scored(1, { unit: "1" })]).toEqual(["2.5 EUR", "5", "–", "1"]);
});

describe("times", () => {
  test("grow coarser as they grow longer", () => {
    expect([3.21, 59.6, 119, 600, 7_300].map(duration)).toEqual(["3.2 s", "60 s", "119 s", "10 min", "2 h 2 min"]);
    expect(duration(null)).toBe("–");
  });

  test("are told from now", () => {
    const now = Date.parse("2026-01-02T12:00:00Z");
    expect(ago("2026-01-02T11:59:40Z", now)).toBe("just now");
    expect(ago("2026-01-02T11:10:00Z", now)).toBe("50 min ago");
    expect(ago("2026-01-02T12:00:05Z", now)).toBe("just now");
    expect([clock("2020-05-05T10:00:00Z"), clock(new Date().toISOString().slice(0, 4) + "-05-05T10:00:00Z")].map((text) => /20\d\d/.test(text))).toEqual([true, false]);
  });

  afterEach(() => vi.unstubAllEnvs());

  test.each([
    ["UTC", "00:30:00", "24 Oct 2026, UTC"],
    ["Europe/Berlin", "02:30:00", "25 Oct 2026, CEST"],
    ["Pacific/Apia", "13:30:00", "25 Oct 2026, GMT+13"],
    ["America/St_Johns", "22:00:00", "24 Oct 2026, GMT-2:30"],
  ])("are those of the reader's zone %s, and ages the same in all, where a clock was set back as well", (name, time, day) => {
    vi.stubEnv("TZ", name);
    expect(clock("2026-10-25T00:30:00Z")).toContain(time); // 02:30 in Berlin, for the first time
    expect(ago("2026-10-24T23:30:00Z", Date.parse("2026-10-26T00:00:00Z"))).toBe(day);
    expect(ago("2026-10-25T00:30:00Z", Date.parse("2026-10-25T01:30:00Z"))).toBe("1 h ago"); // 02:30, for the second time
  });
});

test("what is nearly nothing is rounded to it, where decimals are fixed", () => {
  expect([rounded(-5e-8, 2), rounded(0.0049, 2), rounded(1.239, 2)]).toEqual(["0", "0", "1.24"]);
});
