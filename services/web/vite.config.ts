import { fileURLToPath } from "node:url";
import { svelte } from "@sveltejs/vite-plugin-svelte";
import { defineConfig, type Rolldown } from "vite";
import { licences } from "./licences.ts";

const needed = new Set<string>();

/** Whether the page's script needs a module before any view is opened. */
function isFirst(id: string, graph: Rolldown.ChunkingContext): boolean {
  const main = fileURLToPath(new URL("src/main.ts", import.meta.url));
  if (needed.size === 0) {
    const open = [main];
    for (let next = open.pop(); next !== undefined; next = open.pop()) {
      if (needed.has(next)) continue;
      needed.add(next);
      open.push(...(graph.getModuleInfo(next)?.importedIds ?? []));
    }
  }
  return needed.has(id);
}

// `/` shows the page, everything that belongs to it lies below `/page/`; the API is beside them.
export default defineConfig({
  base: "/page/",
  plugins: [svelte(), licences()],
  build: {
    target: "es2022",
    emptyOutDir: true,
    // Nothing inline: the content security policy forbids it. No polyfill for preloading, which would be.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    // The page, and the documentation of the API, which is a page of its own.
    rolldownOptions: {
      input: ["index.html", "docs.html"],
      // Else what the first script shares with each set of views is a file of its own: ten files before the first view, which browsers ask for six at a time.
      output: { codeSplitting: { groups: [{ name: (id, graph) => (isFirst(id, graph) ? "first" : null), debugName: "first" }] } },
    },
    chunkSizeWarningLimit: 2_000,
    reportCompressedSize: false,
  },
});
