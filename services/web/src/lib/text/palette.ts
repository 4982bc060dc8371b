/** Entries of the command palette: views, campaigns and actions, found by words. */

export interface Entry {
  title: string;
  /** What it is, beside the title. */
  about: string;
  /** Further words that find it. */
  words?: string;
  href?: string;
  act?: () => void;
}

/** How well an entry fits what is written: null if a word is in none of its texts; less is better. */
function fit(entry: Entry, words: readonly string[]): number | null {
  const title = entry.title.toLowerCase();
  const all = `${title} ${entry.about} ${entry.words ?? ""}`.toLowerCase();
  let sum = 0;
  for (const word of words) {
    if (!all.includes(word)) return null;
    const at = title.indexOf(word);
    sum += at === 0 ? 0 : at > 0 && /[\s\W]/.test(title[at - 1] ?? "") ? 1 : at > 0 ? 2 : 3;
  }
  return sum;
}

/** At most so many entries, the best first; those that fit alike stay in their order. */
export function found(entries: readonly Entry[], written: string, most = 12): Entry[] {
  const words = written.toLowerCase().split(/\s+/).filter(Boolean);
  return entries
    .flatMap((entry) => {
      const sum = fit(entry, words);
      return sum === null ? [] : [{ entry, sum }];
    })
    .sort((a, b) => a.sum - b.sum)
    .slice(0, most)
    .map(({ entry }) => entry);
}

/** The place after a step through a list, which goes on at its other end. */
export function stepped(place: number, by: number, length: number): number {
  return length === 0 ? 0 : (place + by + length) % length;
}
