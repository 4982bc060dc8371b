import { existsSync, readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import type { Plugin } from "vite";

/** Writes `licences.txt`: name, version, licence and the licence's text of every package in the page. */
export function licences(): Plugin {
  return {
    name: "licences",
    apply: "build",
    generateBundle(_options, bundle) {
      const folders = new Set<string>();
      for (const one of Object.values(bundle)) {
        if (one.type !== "chunk") continue;
        for (const id of Object.keys(one.modules)) {
          const folder = /^(.*[/\\]node_modules[/\\](?:@[^/\\]+[/\\])?[^/\\]+)[/\\]/.exec(id.replace(/^\0/, ""))?.[1];
          if (folder !== undefined) folders.add(folder);
        }
      }
      const source = [...folders].sort().map(licenceOf).join(`\n${"=".repeat(80)}\n\n`);
      this.emitFile({ type: "asset", fileName: "licences.txt", source });
    },
  };
}

function licenceOf(folder: string): string {
  const about = JSON.parse(readFileSync(join(folder, "package.json"), "utf8")) as { name: string; version: string; license?: string };
  const files = existsSync(folder) ? readdirSync(folder).filter((name) => /^(licen[cs]e|notice|copying)|\.licen[cs]e\.txt$/i.test(name)) : [];
  if (files.length === 0) throw new Error(`${about.name} ships no licence; the page may not hold it`);
  const texts = files.sort().map((name) => readFileSync(join(folder, name), "utf8").trim());
  return `${about.name} ${about.version} (${about.license ?? "see below"})\n\n${texts.join("\n\n")}\n`;
}
