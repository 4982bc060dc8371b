/** The URL holds everything a user may return to or share, behind the `#`. */

import { brushText, parse, write, type Place } from "./address";

export const route = $state<Place>(parse(location.hash));
window.addEventListener("hashchange", () => {
  clearTimeout(writing);
  Object.assign(route, parse(location.hash));
});

/** Browsers take some seven changes of the address per second and drop the rest: a slider that is drawn makes sixty. */
const WRITE_MILLISECONDS = 200;
let writing: ReturnType<typeof setTimeout> | undefined;

export function go(path: readonly string[], query: Record<string, string> = {}): void {
  clearTimeout(writing);
  history.replaceState(null, "", write(route)); // what waits to be written: the way back leads to it
  location.hash = write({ path, query });
}

/** Changes parts of the query in place; null takes one out. Going back leads to the view before, not to every step of a slider. */
export function amend(changes: Record<string, string | null>): void {
  const query = { ...route.query };
  for (const [name, value] of Object.entries(changes)) {
    if (value === null || value === "") delete query[name];
    else query[name] = value;
  }
  route.query = query;
  clearTimeout(writing);
  const here = location.hash;
  writing = setTimeout(() => {
    // A user who followed a link meanwhile is not taken back: browsers report it late.
    if (location.hash === here) history.replaceState(null, "", write(route));
  }, WRITE_MILLISECONDS);
}

/** Keeps ranges of columns in the query; null takes one out. */
export function keep(ranges: Readonly<Record<string, readonly [number, number] | null>>): void {
  amend(Object.fromEntries(Object.entries(ranges).map(([column, range]) => [`b.${column}`, range === null ? null : brushText(range)])));
}

export function link(path: readonly string[], query: Record<string, string> = {}): string {
  return write({ path, query });
}
