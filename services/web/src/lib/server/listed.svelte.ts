/** The campaigns of a filter as the server lists them. */

import { Tagged, messageOf } from "./api";
import type { Campaign, CampaignPage } from "./types";

interface Held {
  tagged: Tagged<CampaignPage>;
  page: CampaignPage | null;
}

/** Newest first, each once: the first page and as many older ones as were asked for. */
export class CampaignList {
  /** Null before the first answer. */
  items = $state.raw<Campaign[] | null>(null);
  /** Whether the server has older ones. */
  goesOn = $state(false);
  problem = $state("");
  private pages = 1;
  private held = new Map<string, Held>();
  private last: Promise<void> = Promise.resolve();

  /** `path`: the request of the newest page. */
  constructor(private readonly path: string) {}

  /** Reads all pages again, one reading after the other. Each page begins where the one before ends now; unchanged pages are not sent again. */
  read(): Promise<void> {
    this.last = this.last.then(() => this.follow());
    return this.last;
  }

  /** Reads one more page. */
  more(): Promise<void> {
    this.pages += 1;
    return this.read();
  }

  private async follow(): Promise<void> {
    const held = new Map<string, Held>();
    const items: Campaign[] = [];
    let cursor: string | null = null;
    try {
      for (let number = 0; number < this.pages; number++) {
        const path: string = cursor === null ? this.path : `${this.path}&cursor=${encodeURIComponent(cursor)}`;
        const entry: Held = this.held.get(path) ?? { tagged: new Tagged<CampaignPage>(path), page: null };
        held.set(path, entry);
        const page: CampaignPage | null = (entry.page = (await entry.tagged.next()) ?? entry.page);
        items.push(...(page?.items ?? []));
        cursor = page?.next_cursor ?? null;
        if (cursor === null) break;
      }
      [this.held, this.items, this.goesOn, this.problem] = [held, items, cursor !== null, ""];
    } catch (error) {
      this.problem = messageOf(error);
    }
  }
}
