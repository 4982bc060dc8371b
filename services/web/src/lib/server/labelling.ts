/** Changes of campaigns from a list or from their own view, one campaign after the other. */

import { messageOf, send } from "./api.svelte";
import type { Campaign, Deletion } from "./types";

type Named = Pick<Campaign, "id" | "name">;

/** Tags are added and removed by name: tags that others add meanwhile stay. */
export interface Labels {
  add_tags?: string[];
  remove_tags?: string[];
  comment?: string;
  archived?: boolean;
  name?: string;
}

/** The ids of the campaigns that were changed, and why the others were not, or not as was asked. */
export interface Changed {
  done: string[];
  refusals: string[];
}

export function relabelled(campaigns: readonly Named[], labels: Labels): Promise<Changed> {
  return each(campaigns, async ({ id }) => {
    await send<Campaign>("PATCH", `/campaigns/${id}`, labels);
    return "";
  });
}

/** A campaign that others refer to is archived instead of being deleted, which counts as a refusal. */
export function deleted(campaigns: readonly Named[]): Promise<Changed> {
  return each(campaigns, async ({ id, name }) => {
    const deletion = await send<Deletion>("DELETE", `/campaigns/${id}`);
    return deletion.deleted ? "" : deletionText(name, deletion);
  });
}

/** `change`: returns what was done instead, empty if nothing was; throws if the server refuses. */
async function each(campaigns: readonly Named[], change: (campaign: Named) => Promise<string>): Promise<Changed> {
  const [done, refusals]: [string[], string[]] = [[], []];
  for (const campaign of campaigns) {
    try {
      const instead = await change(campaign);
      done.push(campaign.id);
      if (instead !== "") refusals.push(instead);
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

/** Why a campaign was archived instead of being deleted. */
export function deletionText(name: string, { referring }: Pick<Deletion, "referring">): string {
  const uses = referring.slice(0, 3).map((reference) => `${reference.name} (${reference.campaign.slice(0, 8)}, ${reference.use})`);
  const more = referring.length > uses.length ? ` and ${referring.length - uses.length} more` : "";
  return `${name} is archived, not deleted. It is referred to by ${uses.join(", ")}${more}.`;
}
