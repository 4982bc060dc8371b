import js from "@eslint/js";
import svelte from "eslint-plugin-svelte";
import ts from "typescript-eslint";

export default ts.config(
  { ignores: ["node_modules", "dist", "schema.d.ts"] },
  js.configs.recommended,
  ...ts.configs.strict,
  ...svelte.configs.recommended,
  { languageOptions: { globals: Object.fromEntries(["window", "document", "location", "fetch", "localStorage"].map((name) => [name, "readonly"])) } },
  { files: ["**/*.svelte", "**/*.svelte.ts"], languageOptions: { parserOptions: { parser: ts.parser } } },
  // TypeScript knows every name; this rule knows none of a browser's.
  { files: ["**/*.ts", "**/*.svelte"], rules: { "no-undef": "off", eqeqeq: "error", "svelte/no-at-html-tags": "error" } },
  {
    rules: {
      "svelte/prefer-svelte-reactivity": "off", // what is shown is in $state; sets and maps are kept where nothing depends on them
      "@typescript-eslint/no-dynamic-delete": "off", // queries of addresses are plain objects of names that are not known beforehand
    },
  },
);
