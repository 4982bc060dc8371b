import { expect, test } from "vitest";

import { csvOf } from "./csv";

test("a text that a spreadsheet would carry out is a text, and a number stays a number", () => {
  const rows = [["=cmd|' /C calc'!A0", "+1+1", "@SUM(A1)", "-x"], [-1.5, "-1.5", "+2", null], ['a "b", c', "x=1", "1-1", ""]];
  expect(csvOf({ head: ["a", "=b"], rows })).toBe(
    "a,'=b\n'=cmd|' /C calc'!A0,'+1+1,'@SUM(A1),'-x\n-1.5,-1.5,+2,\n\"a \"\"b\"\", c\",x=1,1-1,\n",
  );
});
