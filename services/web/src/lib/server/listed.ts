/** The campaigns of a filter as the server lists them. */

import { Tagged } from "./api.svelte";
import type { Campaign, CampaignPage } from "./types";

interface Held {
  tagged: Tagged<CampaignPage>;
  page: CampaignPage | null;
}

export class CampaignList {
  private held = new Map<string, Held>();

  /** `path`: the request of the newest page. */
  constructor(private readonly path: string) {}

  /** Reads the newest pages: each begins where the page before ends now, and unchanged pages are not sent again. `goesOn`: the server has older campaigns. */
  async read(pages: number): Promise<{ items: Campaign[]; goesOn: boolean }> {
    const held = new Map<string, Held>();
    const items: Campaign[] = [];
    let cursor: string | null = null;
    for (let number = 0; number < pages && (number === 0 || cursor !== null); number++) {
      const path: string = cursor === null ? this.path : `${this.path}&cursor=${encodeURIComponent(cursor)}`;
      const entry: Held = this.held.get(path) ?? { tagged: new Tagged<CampaignPage>(path), page: null };
      held.set(path, entry);
      const page: CampaignPage | null = (entry.page = (await entry.tagged.next()) ?? entry.page);
      items.push(...(page?.items ?? []));
      cursor = page?.next_cursor ?? null;
    }
    this.held = held;
    return { items, goesOn: cursor !== null };
  }
}
