/** Where the numbers behind a verdict are shown. */

import type { ResultVerdict } from "../server/types";

/** By parts of codes, the first that fits. `at`: a section of the overview. */
const PLACES: readonly (readonly [RegExp, string, Record<string, string>, string])[] = [
  [/^front/, "front", {}, "front"],
  [/map|audits|contradictions|lots|predictions|robust/, "trust", {}, "checks"],
  [/^fails$|^without/, "overview", { at: "failures" }, "failed runs"],
  [/noise|cut$/, "evaluations", {}, "evaluations"],
  [/baseline|better|ends$/, "overview", { at: "best" }, "best set"],
  [/confirm|scores|tried|judged|constraints|optima/, "ranking", { row: "1" }, "ranking"],
  [/failed|no_result|cancelled/, "overview", { at: "log" }, "log"],
];
const COURSE = [/./, "overview", { at: "course" }, "course"] as const;

export function evidenceOf({ code }: Pick<ResultVerdict, "code">): { view: string; query: Record<string, string>; title: string } {
  const [, view, query, title] = PLACES.find(([codes]) => codes.test(code)) ?? COURSE;
  return { view, query, title };
}
