/** Forms from the API's own description: what a JSON schema says of a value, as a field for it. */

import { Broken } from "./faults";

export interface Schema {
  $ref?: string;
  type?: string;
  description?: string;
  default?: unknown;
  enum?: unknown[];
  const?: unknown;
  anyOf?: Schema[];
  oneOf?: Schema[];
  properties?: Record<string, Schema>;
  required?: string[];
  additionalProperties?: boolean | Schema;
  items?: Schema;
  /** Of the first places, if they differ. */
  prefixItems?: Schema[];
  minItems?: number;
  minimum?: number;
  maximum?: number;
  exclusiveMinimum?: number;
  maxLength?: number;
  patternProperties?: Record<string, Schema>;
}

export type Definitions = Record<string, Schema>;

/** A `list` holds words and numbers, `pairs` numbers by name; `objects` have fields of their own. */
export type Kind = "choice" | "truth" | "whole" | "number" | "text" | "object" | "list" | "pairs" | "objects" | "json";

export interface Described {
  kind: Kind;
  /** May be null: it can be left out altogether. */
  optional: boolean;
  /** Of a list the words that can stand for it, as `all`. */
  choices: unknown[];
  schema: Schema;
  /** What can be given instead of a choice. */
  instead?: Schema;
  /** A number can stand for the list. */
  single?: boolean;
}

export function resolve(schema: Schema, definitions: Definitions): Schema {
  const name = schema.$ref?.split("/").at(-1);
  if (name === undefined) return schema;
  return { ...(definitions[name] ?? {}), ...(schema.default === undefined ? {} : { default: schema.default }) };
}

export function describe(given: Schema, definitions: Definitions): Described {
  const schema = resolve(given, definitions);
  const variants = (schema.anyOf ?? schema.oneOf ?? [schema]).flatMap((entry) => {
    const resolved = resolve(entry, definitions);
    return resolved.anyOf ?? resolved.oneOf ?? [resolved];
  });
  const known = variants.map((variant) => resolve(variant, definitions)).filter((variant) => variant.type !== "null");
  const optional = known.length < variants.length;
  const objects = known.filter((entry) => entry.properties !== undefined);
  const plain = known.filter((entry) => entry.properties === undefined);
  const make = (kind: Kind, from: Schema, choices: unknown[] = []): Described => ({ kind, optional, choices, schema: { ...from, default: schema.default } });
  const only = known.length === 1 ? known[0] : undefined;
  // Of several kinds of objects the first is the usual one; the others can be written as JSON.
  if (objects[0] && plain.length === 0) return make("object", objects[0]);
  if (objects.length === 1 && objects[0] && plain.length === 1 && plain[0]?.enum) return { ...make("choice", plain[0], plain[0].enum), instead: objects[0] };
  if (!only) {
    const lists = known.filter((entry) => isWords(entry, definitions));
    const rest = known.filter((entry) => entry !== lists[0]);
    const stand = rest.every((entry) => entry.const !== undefined || entry.type === "number");
    if (lists[0] && stand) return { ...make("list", lists[0], rest.flatMap((entry) => (entry.const === undefined ? [] : [entry.const]))), single: rest.some((entry) => entry.type === "number") };
    return make("json", schema);
  }
  if (only.enum) return make("choice", only, only.enum);
  if (only.type === "boolean") return make("truth", only);
  if (only.type === "integer") return make("whole", only);
  if (only.type === "number") return make("number", only);
  if (only.type === "string") return make("text", only);
  if (only.type === "array" && only.items && resolve(only.items, definitions).properties) return make("objects", only);
  if (isWords(only, definitions)) return make("list", only);
  const named = Object.values(only.patternProperties ?? {});
  if (named.length > 0 && named.every((entry) => entry.type === "number")) return make("pairs", only);
  return make("json", only);
}

/** Whether it is a list of words or numbers. */
function isWords(schema: Schema, definitions: Definitions): boolean {
  if (schema.type !== "array" || !schema.items) return false;
  const item = resolve(schema.items, definitions);
  return !item.properties && !item.patternProperties;
}

/** The definitions with another default of a property that depends on other settings. */
export function withDefault(definitions: Definitions, model: string, property: string, value: unknown): Definitions {
  const known = definitions[model];
  if (!known?.properties?.[property]) return definitions;
  return { ...definitions, [model]: { ...known, properties: { ...known.properties, [property]: { ...known.properties[property], default: value } } } };
}

/** What an empty field says: the default that holds then, if it can be written. */
export function emptyText({ schema, optional }: Pick<Described, "schema" | "optional">): string {
  const text = listText(schema.default);
  return text !== "" ? `${text} by default` : optional ? "none" : schema.default === undefined ? "needed" : "default";
}

/** An object that is given instead of a choice, with one value changed. What it cannot do without is not left out: of the rest the API would only say that it is no choice. */
export function insteadWith(instead: Schema, document: Readonly<Record<string, unknown>>, name: string, value: unknown): Record<string, unknown> {
  return changed(document, name, value === undefined && instead.required?.includes(name) ? new Broken("", "it is empty", "give a number, or choose another") : value);
}

/** Words and numbers as people write them, `100, 200`; JSON for lists that hold anything else. One of the `choices` stands for itself, and
 * a `single` number, too. */
export function writtenList(text: string, { choices, single = false }: Pick<Described, "choices" | "single"> = { choices: [] }): unknown {
  if (text.trim() === "") return undefined;
  const parsed = /^\s*[[{]/.test(text) ? written(text) : undefined;
  if (Array.isArray(parsed) || parsed instanceof Broken) return parsed;
  const values = text.split(",").map((part) => part.trim()).filter(Boolean).map(written);
  return values.length === 1 && (choices.includes(values[0]) || (single && typeof values[0] === "number")) ? values[0] : values;
}

export function listText(value: unknown): string {
  if (value instanceof Broken) return value.text;
  if (!Array.isArray(value)) return typeof value === "string" || typeof value === "number" ? String(value) : "";
  return value.some((entry) => typeof entry === "object") ? JSON.stringify(value) : value.join(", ");
}

/** Numbers by name as on the command line, `S1=2, S2=0.5`; JSON is taken, too. */
export function writtenPairs(text: string): unknown {
  if (text.trim() === "") return undefined;
  if (/^\s*[[{]/.test(text)) return written(text);
  const pairs = text.split(/[,\n]/).map((part) => part.trim()).filter(Boolean).map((part) => part.split("=").map((side) => side.trim()));
  const wrong = pairs.find(([name, value, ...more]) => !name || !value || more.length > 0 || !Number.isFinite(Number(value)));
  if (wrong) return new Broken(text, `${wrong.join("=")} is no name with a number`, "write S1=2, S2=0.5, for example");
  const twice = pairs.find(([name], place) => pairs.some(([other], before) => before < place && other === name));
  if (twice) return new Broken(text, `${twice[0] ?? ""} is there twice`, "write each name once");
  return Object.fromEntries(pairs.map(([name = "", value]) => [name, Number(value)]));
}

export function pairsText(value: unknown): string {
  if (value instanceof Broken) return value.text;
  return typeof value === "object" && value !== null ? Object.entries(value).map(([name, number]) => `${name}=${String(number)}`).join(", ") : "";
}

/** What an object holds besides the fields that its schema names: settings of a plug-in, for example. */
export function others(value: Readonly<Record<string, unknown>>, schema: Schema): Record<string, unknown> {
  return Object.fromEntries(Object.entries(value).filter(([name]) => !(name in (schema.properties ?? {}))));
}

/** A value of several possible kinds: JSON if the text starts like JSON, else a word. */
export function written(text: string): unknown {
  if (text.trim() === "") return undefined;
  try {
    return JSON.parse(text) as unknown;
  } catch (error) {
    return /^\s*[[{]/.test(text) ? new Broken(text, `this is not valid JSON: ${error instanceof Error ? error.message : String(error)}`, "what begins with [ or { has to be complete") : text;
  }
}

/** A document with one value changed; undefined takes it out, so that the default holds again. */
export function changed(document: Readonly<Record<string, unknown>>, name: string, value: unknown): Record<string, unknown> {
  const made = { ...document, [name]: value };
  if (value === undefined) delete made[name];
  return made;
}

/** Every leaf of a document by its path; lists are leaves, and of an object without any there is nothing to tell. */
function leaves(value: unknown, path = ""): Record<string, string> {
  if (value !== null && typeof value === "object" && !Array.isArray(value)) {
    return Object.assign({}, ...Object.entries(value).map(([name, inner]) => leaves(inner, path === "" ? name : `${path}.${name}`))) as Record<string, string>;
  }
  return { [path]: told(value) };
}

/** A value in words: `score comfort; score safety`. Of an object in a list what is empty or null is left out. */
function told(value: unknown): string {
  if (typeof value === "string") return value;
  if (typeof value === "boolean") return value ? "yes" : "no";
  if (Array.isArray(value)) return value.length === 0 ? "none" : value.map(told).join(value.some((entry) => typeof entry === "object") ? "; " : ", ");
  if (value === null || typeof value !== "object") return JSON.stringify(value);
  const chosen = Object.entries(value).filter(([, inner]) => inner !== null && !(typeof inner === "object" && Object.keys(inner as object).length === 0));
  return chosen.map(([name, inner]) => `${name.replaceAll("_", " ")} ${told(inner)}`).join(", ");
}

/** The paths of documents with the value of each; null if one has none. */
export function fieldsOf(...documents: readonly unknown[]): { path: string; values: (string | null)[] }[] {
  const known = documents.map((document) => leaves(document));
  const paths = [...new Set(known.flatMap((each) => Object.keys(each)))];
  return paths.map((path) => ({ path, values: known.map((each) => each[path] ?? null) }));
}
