/** What is wrong with a form: what the API says of its fields, and text that no value can be made of. */

import { partName } from "../forms/faults";
import type { FieldProblem } from "./types";

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
