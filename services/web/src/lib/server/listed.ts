/** The campaigns of a filter as the server lists them. */

import { Tagged } from "./api.svelte";
import type { Campaign, CampaignPage } from "./types";

export class CampaignList {
  private held = new Map<string, Tagged<CampaignPage>>();

  /** `path`: the request of the newest page. */
  constructor(private readonly path: string) {}

  /** Reads the newest pages: each begins where the page before ends now, and unchanged pages are not sent again. `goesOn`: the server has older campaigns. */
  async read(pages: number): Promise<{ items: Campaign[]; goesOn: boolean }> {
    const held = new Map<string, Tagged<CampaignPage>>();
    const items: Campaign[] = [];
    let cursor: string | null = null;
    for (let number = 0; number < pages && (number === 0 || cursor !== null); number++) {
      const path: string = cursor === null ? this.path : `${this.path}&cursor=${encodeURIComponent(cursor)}`;
      const page: Tagged<CampaignPage> = this.held.get(path) ?? new Tagged<CampaignPage>(path);
      held.set(path, page);
      await page.next();
      items.push(...(page.value?.items ?? []));
      cursor = page.value?.next_cursor ?? null;
    }
    this.held = held;
    return { items, goesOn: cursor !== null };
  }
}
