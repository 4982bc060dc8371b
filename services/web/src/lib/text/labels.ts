/** Labels of campaigns in words. */

import type { Deletion } from "../server/types";

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
