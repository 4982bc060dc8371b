/** What is wrong with a form, and where: what the API says of its fields, and text that no value can be made of. */

import type { FieldProblem } from "../server/types";

type Wanted = Readonly<Record<string, unknown>>;

/** A cell of the grid of parameters; without a column the whole row. */
export interface GridPlace {
  parameter: string;
  column: "from" | "to" | "step" | "held at" | "baseline" | "";
}

const COLUMNS: Readonly<Record<string, GridPlace["column"]>> = { lower: "from", upper: "to", step: "step" };

/** The place in the grid of parameters that a path is about; null for any other path. */
export function gridPlace(path: string, wanted: Wanted): GridPlace | null {
  const [, section, name = ""] = /^(fixed|baseline)\.(.+)$/.exec(path) ?? [];
  if (section !== undefined) return { parameter: name, column: section === "fixed" ? "held at" : "baseline" };
  const [, place, field = ""] = /^parameters\[(\d+)\](?:\.(\w+))?/.exec(path) ?? [];
  const listed: unknown = place === undefined || !Array.isArray(wanted["parameters"]) ? undefined : wanted["parameters"][Number(place)];
  const parameter = (listed as { name?: unknown } | null | undefined)?.name;
  return typeof parameter === "string" ? { parameter, column: COLUMNS[field] ?? "" } : null;
}

/** Sections that hold names of a user. */
const OWN: readonly string[] = ["weights", "parameters", "fixed", "baseline", "start_sets"];

/** The name of a field as the form writes it: `P2, to`; `objective 1, aggregate`. */
export function fieldName(path: string, wanted: Wanted = {}): string {
  const place = gridPlace(path, wanted);
  if (place) return [place.parameter, place.column].filter(Boolean).join(", ");
  const weight = /^weights\.(.+)$/.exec(path);
  if (weight) return `weight of ${weight[1] ?? ""}`;
  const parts = path.split(".");
  /** The first part that a user named. */
  const own = parts.findIndex((_, at) => OWN.includes((parts[at - 1] ?? "").replace(/\[.*/, "")));
  return parts.map((part, at) => (own >= 0 && at >= own ? part : part.replaceAll("_", " ")).replace(/^(.*?)s?((?:\[\d+\])+)$/, (_, name: string, places: string) => `${name} ${counted(places)}`)).join(", ");
}

/** Places in lists, counted from 1. */
function counted(places: string): string {
  return [...places.matchAll(/\d+/g)].map(([place]) => Number(place) + 1).join(", ");
}

/** What stands inside a field that is one text, in the words of that text: `[0].P1` is `1, P1`. */
export function partName(rest: string): string {
  return rest.replace(/^\./, "").replaceAll(/((?:\[\d+\])+)\.?(?=(.?))/g, (_, places: string, next: string) => `${counted(places)}${next && ", "}`);
}

/** The ids of what can be brought into sight for a fault, the nearest first. */
export function placesOf(path: string, wanted: Wanted): string[] {
  const place = gridPlace(path, wanted);
  const around = path.split(/(?=[.[])/).map((_, at, parts) => `field-${parts.slice(0, parts.length - at).join("")}`);
  return [...(place ? [gridId(place), gridId({ ...place, column: "" })] : []), ...around, ...(/^(fixed|baseline)\b/.test(path) ? ["field-parameters"] : path.startsWith("catalogue") ? ["field-weights"] : [])];
}

/** The id of a field of the grid, or of its row. */
export function gridId({ parameter, column }: GridPlace): string {
  return `grid-${parameter}${column && `-${column.replace(" ", "-")}`}`;
}

/** Text in a field that no value can be made of; it is never sent. */
export class Broken {
  constructor(
    readonly text: string,
    readonly reason: string,
    readonly remedy: string,
  ) {}

  toJSON(): string {
    return this.text;
  }
}

/** What is wrong and what would be right, as one sentence. */
export function said(problem: FieldProblem): string {
  return [problem.message, problem.remedy].filter(Boolean).join("; ");
}

/** Whether a problem is about something inside the field at `path`. */
export function inside(problem: FieldProblem, path: string): boolean {
  return problem.field.startsWith(`${path}.`) || problem.field.startsWith(`${path}[`);
}

/** The problems to show at the field of `path`: its own and, if it has no `fields`, the problems of anything inside it. */
export function at(problems: readonly FieldProblem[], path: string, fields = false): string[] {
  return problems.flatMap((problem) => (problem.field === path ? [said(problem)] : !fields && inside(problem, path) ? [`${partName(problem.field.slice(path.length))}: ${said(problem)}`] : []));
}

/** The fields of a form with such text. */
export function brokenIn(value: unknown, path = ""): FieldProblem[] {
  if (value instanceof Broken) return [{ field: path, message: value.reason, remedy: value.remedy }];
  if (Array.isArray(value)) return value.flatMap((entry, place) => brokenIn(entry, `${path}[${place}]`));
  if (typeof value !== "object" || value === null) return [];
  return Object.entries(value).flatMap(([name, entry]) => brokenIn(entry, path === "" ? name : `${path}.${name}`));
}
