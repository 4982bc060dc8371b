/** Chosen sets while a campaign ranks new ones: the address names sets by ranks, and in the next table a rank may be another set's. */

import { wordsOf, wordsText } from "./address";
import { amend, route } from "./route.svelte";

/** A chosen set: its rank in the address, and what it keeps in every table. */
interface Chosen { rank: string; set: string }

/** What a table tells of its sets: null for a rank, or a set, that it does not have. */
export interface Ranked { setOf: (rank: string) => string | null; rankOf: (set: string) => string | null }

/** The ranks that chosen sets have in a table, and these sets. A rank that is not in `before` names a set of this table. */
export function followed(ranks: readonly string[], before: readonly Chosen[], { setOf, rankOf }: Ranked): { ranks: string[]; chosen: Chosen[] } {
  const chosen = ranks.map((rank) => {
    const set = before.find((entry) => entry.rank === rank)?.set ?? setOf(rank);
    // A set that kept its rank is not searched for in a long table.
    return { rank: set === null || setOf(rank) === set ? rank : (rankOf(set) ?? rank), set };
  });
  return { ranks: chosen.map(({ rank }) => rank), chosen: chosen.filter((entry): entry is Chosen => entry.set !== null) };
}

/** Keeps `row` and `with` of the address at the sets that were chosen. `ranking` returns null while there is none, or another one. */
export function followChosen(ranking: () => Ranked | null): void {
  let chosen: Chosen[] = [];
  $effect(() => {
    const table = ranking();
    const row = route.query["row"] === undefined ? [] : [route.query["row"]];
    const before = [...row, ...wordsOf(route.query["with"])];
    const after = table === null ? { ranks: before, chosen: [] } : followed(before, chosen, table);
    chosen = after.chosen;
    if (after.ranks.some((rank, place) => rank !== before[place])) {
      amend({ row: after.ranks.slice(0, row.length)[0] ?? null, with: wordsText(after.ranks.slice(row.length)) });
    }
  });
}
