/** What a form says of its fields besides what the API's description says: names that can be chosen, and what a field is for. */

import { capital, count } from "../text/format";
import type { Shape } from "../server/shape";
import fields from "./fields.json";
import type { Schema } from "./schema";

/** By the path of a field, `[]` for any place in a list. */
export type Choices = Readonly<Record<string, readonly string[]>>;

/** Built-in plug-ins; the API lists the names of others only when it refuses one, so any name can be typed. */
export const BUILT_IN: Choices = fields.names;
const BEGINS: Readonly<Record<string, Readonly<Record<string, unknown>>>> = fields.begins;
const HELP: Readonly<Record<string, string>> = fields.help;

/** More scenarios are written, not ticked. */
const TICKED = 24;

/** The scores, measures and scenarios that goals of a problem can name. */
export function goalChoices(shape: Pick<Shape, "scores" | "measures" | "scenarios"> | null): Choices {
  if (!shape) return {};
  const [scores, measures] = [shape.scores.map(({ name }) => name), Object.keys(shape.measures)];
  const scenarios = shape.scenarios.length > TICKED ? [] : shape.scenarios.map((scenario) => scenario.id);
  return Object.fromEntries(["objectives", "constraints"].flatMap((field) => [[`${field}[].score`, scores], [`${field}[].measure`, measures], [`${field}[].scenarios`, scenarios]]));
}

/** The names that can be chosen at a path. */
export function choicesAt(choices: Choices, path: string): readonly string[] {
  return choices[path.replace(/\[\d+\]/g, "[]")] ?? [];
}

/** What an object begins with that is given instead of a choice. */
export function beginAt(path: string): Readonly<Record<string, unknown>> {
  return BEGINS[path.replace(/\[\d+\]/g, "[]")] ?? {};
}

/** Few fields reach a limit above this number. */
const BEYOND = 1e6;

/** The first paragraph of a description, without references to a paper that few readers have at hand. */
export function aboutSection(description: string): string {
  return (description.split("\n\n")[0] ?? "").replaceAll("`", "").replaceAll(/ \((Sections?|Tables?|Figures?) [^)]*\)/g, "");
}

/** What is said below a field: its description, else ours; and its limits. */
export function helpAt(path: string, schema: Schema, names: readonly string[] = []): string {
  const own = schema.description?.split("\n\n")[0]?.replaceAll("`", "") ?? HELP[path.replace(/\[\d+\]/g, "[]")] ?? "";
  const least = schema.minimum ?? schema.exclusiveMinimum;
  const limits = [
    least !== undefined && Math.abs(least) < BEYOND ? `${schema.minimum === undefined ? "more than" : "at least"} ${bound(least)}` : "",
    schema.maximum !== undefined && Math.abs(schema.maximum) < BEYOND ? `at most ${bound(schema.maximum)}` : "",
  ].filter(Boolean);
  const said = limits.join(", ");
  return [own.replaceAll("`", ""), names.length > 0 ? `Installed: ${names.join(", ")}.` : "", said && `${capital(said)}.`].filter(Boolean).join(" ");
}

function bound(value: number): string {
  return Number.isInteger(value) ? count(value) : String(value);
}
