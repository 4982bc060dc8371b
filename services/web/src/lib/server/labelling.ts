/** Changes of campaigns from a list or from their own view, one campaign after the other. */

import { deletionText } from "../text/labels";
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
