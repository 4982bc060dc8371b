/** Entries of the command palette: views, campaigns and actions, found by words. */

export interface Entry {
  title: string;
  /** What it is. */
  about: string;
  /** Further words that find it. */
  words?: string;
  href?: string;
  act?: () => void;
}

/** The entries with all written words, at most `most`: first entries whose title begins with the first word; the others stay in their order. */
export function found(entries: readonly Entry[], written: string, most = 12): Entry[] {
  const words = written.toLowerCase().split(/\s+/).filter(Boolean);
  const begins = ({ title }: Entry): number => Number(title.toLowerCase().startsWith(words[0] ?? ""));
  const fitting = entries.filter(({ title, about, words: more = "" }) => words.every((word) => `${title} ${about} ${more}`.toLowerCase().includes(word)));
  return fitting.sort((one, other) => begins(other) - begins(one)).slice(0, most);
}

/** The place after a step through a list, which goes on at its other end. */
export function stepped(place: number, by: number, length: number): number {
  return length === 0 ? 0 : (place + by + length) % length;
}
