/** The section `optimizer` of a form: the settings of the chosen optimizer, as its plug-in declares them. */

import type { OptimizerAnswer } from "../server/types";
import type { Shape } from "../server/shape";
import { changed, resolve, type Definitions, type Schema } from "./schema";

type Settings = Readonly<Record<string, unknown>>;

/** The names of optimizers that can search a problem. */
export function suiting(optimizers: readonly OptimizerAnswer[], shape: Shape | null): string[] {
  const needed = shape === null ? [] : [...new Set([...shape.parameters.map((parameter) => String(parameter.kind)), ...(shape.constraints.length > 0 ? ["constraints"] : [])])];
  return optimizers.filter(({ supports }) => needed.every((ability) => supports.includes(ability))).map(({ name }) => name);
}

/** All optimizers begin with given sets and imported results, whether or not a plug-in declares them. */
const START: Readonly<Record<string, Schema>> = {
  start_sets: { type: "array", items: { type: "object" }, default: [] },
  start_results: { anyOf: [{ type: "string", maxLength: 200 }, { type: "null" }], default: null },
};

/** The schema of the section for the chosen optimizer; that of all optimizers if it declares none. */
export function sectionOf(general: Schema, optimizers: readonly OptimizerAnswer[], settings: unknown): Schema {
  const chosen = settings ?? general.default;
  const kind = kindOf(chosen);
  const own = ownOf(optimizers, chosen);
  if (own?.properties === undefined) return general;
  const undeclared = Object.fromEntries(Object.entries(START).filter(([name]) => !(name in (own.properties ?? {}))));
  const section: Schema = { ...own, description: own.description ?? "", properties: { ...own.properties, kind: { type: "string", default: kind }, ...undeclared } };
  return { anyOf: [section, { type: "null" }], default: general.default };
}

/** Settings that a comparison chooses for all of its optimizers. */
const COMMON: readonly string[] = ["kind", "population", "iterations", "start", "seed", "start_sets"];

/** The list of compared optimizers: each with the settings that its plug-in declares. */
export function comparedOf(general: Schema, optimizers: readonly OptimizerAnswer[], listed: unknown, definitions: Definitions): Schema {
  const item = resolve(general.items ?? {}, definitions);
  const sections = (Array.isArray(listed) ? listed : []).map((settings): Schema => {
    const own = ownOf(optimizers, settings);
    if (own?.properties === undefined) return item;
    const further = Object.entries(own.properties).filter(([name]) => !COMMON.includes(name));
    return { ...item, additionalProperties: false, properties: { ...item.properties, ...Object.fromEntries(further) } };
  });
  return { ...general, prefixItems: sections };
}

/** The section with another value: settings of an optimizer that is not chosen any more are left out. */
export function withSettings(optimizers: readonly OptimizerAnswer[], before: unknown, after: unknown): unknown {
  if (typeof after !== "object" || after === null || kindOf(before) === kindOf(after)) return after;
  const own = ownOf(optimizers, after);
  if (own?.properties === undefined) return after;
  return Object.keys(after).filter((name) => !["kind", ...Object.keys(START)].includes(name) && !(name in (own.properties ?? {}))).reduce<Settings>((left, name) => changed(left, name, undefined), after as Settings);
}

function ownOf(optimizers: readonly OptimizerAnswer[], settings: unknown): Schema | undefined {
  return optimizers.find(({ name }) => name === kindOf(settings))?.settings as Schema | undefined;
}

function kindOf(settings: unknown): string {
  return String((settings as Settings | null | undefined)?.["kind"] ?? "surrogate");
}
