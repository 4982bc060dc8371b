/** Changes of campaigns from a list or from their own view, one campaign after the other. */

import { messageOf, send } from "./api.svelte";
import type { Campaign } from "./types";

type Named = Pick<Campaign, "id" | "name">;

/** Tags are added and removed by name: tags that others add meanwhile stay. */
export interface Labels {
  add_tags?: string[];
  remove_tags?: string[];
  name?: string;
}

/** The ids of the campaigns that were changed, and why the others were not. */
export interface Changed {
  done: string[];
  refusals: string[];
}

export function relabelled(campaigns: readonly Named[], labels: Labels): Promise<Changed> {
  return each(campaigns, ({ id }) => send<Campaign>("PATCH", `/campaigns/${id}`, labels));
}

export function deleted(campaigns: readonly Named[]): Promise<Changed> {
  return each(campaigns, ({ id }) => send<undefined>("DELETE", `/campaigns/${id}`));
}

async function each(campaigns: readonly Named[], change: (campaign: Named) => Promise<unknown>): Promise<Changed> {
  const [done, refusals]: [string[], string[]] = [[], []];
  for (const campaign of campaigns) {
    try {
      await change(campaign);
      done.push(campaign.id);
    } catch (error) {
      refusals.push(`${campaign.name}: ${messageOf(error)}`);
    }
  }
  return { done, refusals };
}

/** Tags as people write them, with spaces or commas between them. */
export function writtenTags(text: string): string[] {
  return [...new Set(text.split(/[\s,]+/).filter(Boolean))];
}

/** All tags of campaigns, frequent ones first. */
export function tagsOf(campaigns: readonly { tags: readonly string[] }[]): [string, number][] {
  const counts = new Map<string, number>();
  for (const { tags } of campaigns) for (const tag of tags) counts.set(tag, (counts.get(tag) ?? 0) + 1);
  return [...counts].sort(([a, some], [b, others]) => others - some || a.localeCompare(b, "en"));
}
