/** Addresses as `#/campaigns/ID/evaluations?w.outcome=reused&b.P1=0:2.5`. Names of columns stand behind a mark: a parameter may be called `sort`. */

export interface Place {
  path: readonly string[];
  query: Readonly<Record<string, string>>;
}

export function parse(hash: string): Place {
  const [path = "", query = ""] = hash.replace(/^#\/?/, "").split("?", 2);
  return {
    path: path.split("/").filter(Boolean).map(decoded),
    query: Object.fromEntries(new URLSearchParams(query)),
  };
}

export function write(place: Place): string {
  const query = new URLSearchParams(place.query).toString();
  return `#/${place.path.map(encodeURIComponent).join("/")}${query ? `?${query}` : ""}`;
}

function decoded(part: string): string {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}

/** The words of a filter in a query: `w.scenario=S1,S2`. Commas within a word are encoded. */
export function wordsOf(text: string | undefined): string[] {
  return (text ?? "").split(",").filter(Boolean).map(decoded);
}

export function wordsText(words: readonly string[]): string {
  return words.map((word) => word.replaceAll("%", "%25").replaceAll(",", "%2C")).join(",");
}

/** A list with a word more, or without it. */
export const toggled = (words: readonly string[], word: string): string[] => (words.includes(word) ? words.filter((entry) => entry !== word) : [...words, word]);

/** The ranges in a query: `b.P1=0:2.5`. Either end may be left open. */
export function brushes(query: Readonly<Record<string, string>>): Record<string, [number, number]> {
  const ranges: Record<string, [number, number]> = {};
  for (const [name, value] of Object.entries(query)) {
    if (!name.startsWith("b.")) continue;
    const [low = "", high = ""] = value.split(":", 2);
    const range: [number, number] = [low === "" ? -Infinity : Number(low), high === "" ? Infinity : Number(high)];
    if (!range.some(Number.isNaN)) ranges[name.slice(2)] = range;
  }
  return ranges;
}

/** The part of a query that selects rows by words or ranges; equal parts are equal texts. */
export function selecting(query: Readonly<Record<string, string>>): string {
  return new URLSearchParams(Object.entries(query).filter(([name]) => /^[bw]\./.test(name))).toString();
}

/** Ends are rounded only outwards: a row at an end stays in its range. */
export function brushText([low, high]: readonly [number, number]): string {
  const end = (value: number, outwards: 1 | -1): string => {
    if (!Number.isFinite(value)) return "";
    const short = Number(value.toPrecision(9));
    return String(outwards * short >= outwards * value ? short : value);
  };
  return `${end(low, -1)}:${end(high, 1)}`;
}
