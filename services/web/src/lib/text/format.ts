/** Numbers and times for people. */

const grouped = new Intl.NumberFormat("en-GB", { maximumFractionDigits: 0 });

export function count(value: number): string {
  return grouped.format(value);
}

/** Smaller numbers are what rounding leaves of differences between numbers up to 1,000. */
const NOTHING = 5e-13;

/** A number with as many decimals as it needs, at most `digits`; small ones keep as many digits instead, that none becomes 0. */
export function number(value: number | string | null | undefined, digits = 3): string {
  if (typeof value === "string") return value;
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (Number.isInteger(value) && Math.abs(value) < 1e15) return Math.abs(value) >= 10_000 ? grouped.format(value) : String(value);
  const small = Math.abs(value) < 10 ** (1 - digits) && Math.abs(value) >= NOTHING;
  return String(Number(small ? value.toPrecision(Math.max(1, digits - 1)) : value.toFixed(digits)));
}

/** A message of the API as a sentence. */
export function capital(text: string): string {
  return text.charAt(0).toUpperCase() + text.slice(1);
}

/** A number without more decimals, whose traces become 0. */
export function rounded(value: number, digits: number): string {
  return number(Number(value.toFixed(digits)), digits);
}

/** A name of the API for readers. */
export function spaced(name: string): string {
  return name.replaceAll("_", " ");
}

/** A truth value of the API for readers. */
export function yesNo(word: string): string {
  return word === "true" ? "yes" : word === "false" ? "no" : word;
}

/** A share as a percentage that never rounds something to nothing, or a part to all. */
export function percent(share: number | null | undefined, digits = 1): string {
  if (share === null || share === undefined || Number.isNaN(share)) return "–";
  const least = 10 ** -(digits + 2);
  if (share > 0 && share < least) return `< ${(least * 100).toFixed(digits)} %`;
  if (share < 1 && share > 1 - least) return `> ${((1 - least) * 100).toFixed(digits)} %`;
  return `${(share * 100).toFixed(digits)} %`;
}

export function duration(seconds: number | null | undefined): string {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return "–";
  if (seconds < 10) return `${Math.max(0, seconds).toFixed(1)} s`;
  const whole = Math.round(seconds);
  if (whole < 120) return `${whole} s`;
  const minutes = Math.round(seconds / 60);
  if (minutes < 120) return `${minutes} min`;
  return `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

export function ago(moment: string | null, now: number): string {
  if (moment === null) return "–";
  const seconds = Math.max(0, (now - Date.parse(moment)) / 1000);
  if (seconds < 60) return "just now";
  if (seconds < 3600) return `${Math.floor(seconds / 60)} min ago`;
  if (seconds < 86_400) return `${Math.floor(seconds / 3600)} h ago`;
  return new Date(moment).toLocaleDateString("en-GB", { day: "numeric", month: "short", year: "numeric", timeZoneName: "short" });
}

export function clock(moment: string): string {
  const year = moment.startsWith(new Date().toISOString().slice(0, 4)) ? {} : ({ year: "numeric" } as const);
  return new Date(moment).toLocaleString("en-GB", { day: "numeric", month: "short", ...year, hour: "2-digit", minute: "2-digit", second: "2-digit", timeZoneName: "short" });
}

/** A unit as a cell of a table; nothing for values without unit. */
export function unitText(unit: unknown): string {
  return typeof unit === "string" && unit !== "1" ? unit.replaceAll("^2", "²").replaceAll("^3", "³") : "";
}

/** The unit after a value, with a space; points are what scores are counted in anyway. */
export function unitAfter(unit: string): string {
  return unit === "1" || unit === "points" ? "" : ` ${unitText(unit)}`;
}

/** Units at the end of names, as the built-in problem writes them. */
const SUFFIXES: Readonly<Record<string, string>> = { m: "m", s: "s", mps: "m/s", mps2: "m/s²", mps3: "m/s³", mps15: "m/s¹·⁵", rad: "rad", radps: "rad/s", deg: "°" };

/** The words of a measure's name, and its unit: the declared unit, else the suffix of the name. */
export function measured(name: string, declared?: unknown): { words: string; unit: string } {
  const parts = name.split("_");
  const suffix = parts.length > 1 ? SUFFIXES[parts.at(-1) ?? ""] : undefined;
  const unit = unitText(declared);
  if (suffix === undefined || (declared !== undefined && unit !== suffix)) return { words: parts.join(" "), unit };
  return { words: parts.slice(0, -1).join(" "), unit: suffix };
}

/** A score with its unit; of points the unit goes without saying. */
export function scored(value: number | null | undefined, scale: { unit: string }, digits = 3): string {
  return number(value, digits) + (value === null || value === undefined ? "" : unitAfter(scale.unit));
}

/** The largest difference of scores that is no error, with its unit. */
export function tolerated(scale: { tolerance: number; unit?: string }): string {
  const unit = scale.unit ?? "1";
  if (unit === "1") return String(scale.tolerance);
  return scale.tolerance === 1 && unit === "points" ? "1 point" : `${scale.tolerance} ${unit}`;
}
