/** Changes of campaigns from a list or from their own view, one campaign after the other. */

import { deletionText } from "../text/labels";
import { messageOf, send } from "./api";
import type { Campaign, Deletion } from "./types";

type Named = Pick<Campaign, "id" | "name">;

/** Tags are added and removed by name: those that others add meanwhile stay. */
export interface Labels {
  add_tags?: string[];
  remove_tags?: string[];
  comment?: string;
  archived?: boolean;
  name?: string;
}

/** The ids of the campaigns that were changed, and why the others were not. */
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

/** `change`: returns why it was not done, empty if it was. */
async function each(campaigns: readonly Named[], change: (campaign: Named) => Promise<string>): Promise<Changed> {
  const [done, refusals]: [string[], string[]] = [[], []];
  for (const campaign of campaigns) {
    const refusal = await change(campaign).catch((error: unknown) => `${campaign.name}: ${messageOf(error)}`);
    if (refusal === "") done.push(campaign.id);
    else refusals.push(refusal);
  }
  return { done, refusals };
}
