/** The event stream of a campaign, which is resumed after a break. */

import { ROOT, isReport } from "./api.svelte";
import type { CampaignEvent, Moving } from "./types";

export interface Follower {
  event: (event: CampaignEvent) => void;
  progress: (moving: Moving) => void;
  /** The stream ended or broke off: what it did not tell must be requested. */
  over: () => void;
}

const AGAIN_MILLISECONDS = 2_000;

/** Follows a campaign until the returned function is called. Browsers open six connections to a server: a tab in the background has none. */
export function follow(campaign: string, follower: Follower): () => void {
  if (isReport) return () => undefined;
  const address = `${ROOT}/campaigns/${encodeURIComponent(campaign)}/events`;
  let newest = 0;
  let stream: AbortController | null = null;
  let timer: ReturnType<typeof setTimeout> | undefined;

  const take = (kind: string, data: string): void => {
    if (kind === "progress") {
      follower.progress(JSON.parse(data) as Moving);
      return;
    }
    const event = JSON.parse(data) as CampaignEvent;
    newest = event.id ?? newest;
    follower.event(event);
  };
  const connect = async (): Promise<void> => {
    if (stream !== null || document.hidden) return;
    const own = (stream = new AbortController());
    let ended = false;
    try {
      const answer = await fetch(address, { signal: own.signal, headers: newest > 0 ? { "Last-Event-ID": String(newest) } : {} });
      ended = answer.status === 204;
      if (answer.status === 200 && answer.body !== null) await read(answer.body, take);
    } catch {
      // left, or the server is away: other requests tell
    }
    if (own.signal.aborted) return;
    stream = null;
    follower.over();
    if (!ended) timer = setTimeout(() => void connect(), AGAIN_MILLISECONDS);
  };
  const leave = (): void => {
    clearTimeout(timer);
    stream?.abort();
    stream = null;
  };
  const seen = (): void => {
    leave();
    void connect();
  };
  document.addEventListener("visibilitychange", seen);
  void connect();
  return () => {
    document.removeEventListener("visibilitychange", seen);
    leave();
  };
}

/** Reads an event stream to its end. */
export async function read(body: ReadableStream<Uint8Array>, take: (kind: string, data: string) => void): Promise<void> {
  const reader = body.getReader();
  const decoder = new TextDecoder();
  let rest = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    const blocks = (rest + decoder.decode(value, { stream: true })).split("\n\n");
    rest = blocks.pop() ?? "";
    for (const block of blocks) {
      const fields = new Map(block.split("\n").map((line) => [line.slice(0, line.indexOf(":")), line.slice(line.indexOf(":") + 2)]));
      const data = fields.get("data");
      if (data !== undefined) take(fields.get("event") ?? "", data);
    }
  }
}
