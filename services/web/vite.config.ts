import { svelte } from "@sveltejs/vite-plugin-svelte";
import { resolve } from "node:path";
import { defineConfig } from "vite";
import { licences } from "./licences.ts";

// `/` shows the page, its files have addresses below `/page/`.
export default defineConfig({
  base: "/page/",
  plugins: [svelte(), licences()],
  resolve: { alias: { $lib: resolve(import.meta.dirname, "src/lib"), vitest: resolve(import.meta.dirname, "node_modules/vitest") } },
  build: {
    target: "es2022",
    emptyOutDir: true,
    // Nothing inline: the content security policy forbids it. No polyfill for preloading, which would be.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    // The page, and the documentation of the API, which is a page of its own.
    rolldownOptions: { input: ["index.html", "docs.html"] },
    chunkSizeWarningLimit: 2_000,
    reportCompressedSize: false,
  },
});
