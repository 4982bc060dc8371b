/** Forms from the API's own description: what a JSON schema says of a value, as a field for it. */

import { Broken } from "../server/problems";

export interface Schema {
  $ref?: string;
  type?: string;
  title?: string;
  description?: string;
  default?: unknown;
  enum?: unknown[];
  const?: unknown;
  anyOf?: Schema[];
  oneOf?: Schema[];
  properties?: Record<string, Schema>;
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

/** `list`: of words and numbers; `objects`: of objects, each with fields of its own. */
export type Kind = "choice" | "truth" | "whole" | "number" | "text" | "object" | "list" | "objects" | "json";

export interface Described {
  kind: Kind;
  /** May be null: it can be left out altogether. */
  optional: boolean;
  choices: unknown[];
  schema: Schema;
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
  if (!only) return make("json", schema);
  if (only.enum) return make("choice", only, only.enum);
  if (only.type === "boolean") return make("truth", only);
  if (only.type === "integer") return make("whole", only);
  if (only.type === "number") return make("number", only);
  if (only.type === "string") return make("text", only);
  if (only.type === "array" && only.items) {
    const item = resolve(only.items, definitions);
    if (item.properties) return make("objects", only);
    if (!item.patternProperties) return make("list", only);
  }
  return make("json", only);
}

/** The definitions with another default of a property that depends on other settings. */
export function withDefault(definitions: Definitions, model: string, property: string, value: unknown): Definitions {
  const known = definitions[model];
  if (!known?.properties?.[property]) return definitions;
  return { ...definitions, [model]: { ...known, properties: { ...known.properties, [property]: { ...known.properties[property], default: value } } } };
}

/** Words and numbers as people write them, `100, 200`; JSON for lists that hold anything else. */
export function writtenList(text: string): unknown[] | Broken | undefined {
  if (text.trim() === "") return undefined;
  const parsed = /^\s*[[{]/.test(text) ? written(text) : undefined;
  if (Array.isArray(parsed) || parsed instanceof Broken) return parsed;
  return text.split(",").map((part) => part.trim()).filter(Boolean).map(written);
}

export function listText(value: unknown): string {
  if (value instanceof Broken) return value.text;
  if (!Array.isArray(value)) return "";
  return value.some((entry) => typeof entry === "object") ? JSON.stringify(value) : value.join(", ");
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
    return /^\s*[[{]/.test(text) ? new Broken(text, error instanceof Error ? error.message : String(error)) : text;
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

/** The paths at which documents differ, with the value of each; null if one has none. */
export function differences(...documents: readonly unknown[]): { path: string; values: (string | null)[] }[] {
  const known = documents.map((document) => leaves(document));
  const paths = [...new Set(known.flatMap((each) => Object.keys(each)))];
  return paths.map((path) => ({ path, values: known.map((each) => each[path] ?? null) })).filter(({ values }) => new Set(values).size > 1);
}
