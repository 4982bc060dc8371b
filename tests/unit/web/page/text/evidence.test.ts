import { expect, test } from "vitest";

import { evidenceOf } from "$lib/text/news";

test("a verdict leads to the view with its numbers", () => {
  const leads = { front_copied: "front", predictions_validated: "checks", not_robust: "checks", noise: "evaluations", without_score: "failed runs", fails: "failed runs", at_ends: "best set", not_better: "best set", unconfirmed_failed: "ranking", scores_copied: "ranking", cancelled: "log", not_converged: "course", outlook: "course" };
  expect(Object.keys(leads).map((code) => evidenceOf({ code }).title)).toEqual(Object.values(leads));
});

test("failed runs of the best set are those of its own values", () => {
  expect(evidenceOf({ code: "failing_runs" }, { gain: 0.5, parameter_score: 2, style: "a,b" }).query).toEqual({ "b.gain": "0.5:0.5", "b.parameter_score": "2:2", "w.style": "a%2Cb", sort: "failure" });
  expect(evidenceOf({ code: "failing_runs" }).view).toBe("overview");
});
