import { expect, test } from "vitest";
import { Broken, brokenIn, fieldName, gridPlace, partName } from "$lib/forms/faults";
import { written, writtenList } from "$lib/forms/schema";

const WANTED = { parameters: [{ name: "P7" }, { name: "P2", lower: 1 }] };

test("a fault of a parameter is at its row, however the parameters are listed", () => {
  expect(gridPlace("parameters[1].upper", WANTED)).toEqual({ parameter: "P2", column: "to" });
  expect(gridPlace("parameters[1]", WANTED)).toEqual({ parameter: "P2", column: "" });
  expect(gridPlace("parameters[1].choices[0]", WANTED)).toEqual({ parameter: "P2", column: "" });
  expect(gridPlace("fixed.P7", {})).toEqual({ parameter: "P7", column: "held at" });
  expect(gridPlace("baseline.gain.left", {})).toEqual({ parameter: "gain.left", column: "baseline" });
  for (const path of ["parameters", "parameters[2].upper", "fixed", "baseline", "optimizer.population"]) expect(gridPlace(path, WANTED)).toBeNull();
});

test("a field is named as the form labels it", () => {
  const names = ["parameters[1].upper", "parameters[1]", "fixed.P7", "weights.S9", "objectives[0]", "objectives[0].aggregate.quantile", "constraints[1].at_least", "optimizer.start_sets[2].P1", "seeds[0]", "name"];
  expect(names.map((name) => fieldName(name, WANTED))).toEqual(["P2, to", "P2", "P7, held at", "weight of S9", "objective 1", "objective 1, aggregate, quantile", "constraint 2, at least", "optimizer, start set 3, P1", "seed 1", "name"]);
  expect(fieldName("vehicle.parameters.yaw_inertia")).toBe("vehicle, parameters, yaw_inertia");
  expect(["[0].P_1", "[1]", ".yaw_inertia", "[2][0]"].map(partName)).toEqual(["1, P_1", "2", "yaw_inertia", "3, 1"]);
});

test("half of a JSON document is neither a word nor a list of words", () => {
  const wanted = { parameters: written('[{"name":"P1"'), seeds: writtenList("[1, 2"), optimizers: [{ kind: "genetic" }, { mutation: written("{") }] };
  expect(wanted.parameters).toBeInstanceOf(Broken);
  expect(brokenIn(wanted).map((entry) => entry.field)).toEqual(["parameters", "seeds", "optimizers[1].mutation"]);
  expect(brokenIn({ name: written("a [strange] name"), none: null })).toEqual([]);
  expect(JSON.stringify({ seeds: wanted.seeds })).toBe('{"seeds":"[1, 2"}');
});
