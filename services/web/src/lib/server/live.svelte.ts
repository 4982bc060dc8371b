/** The live connection: a single WebSocket for the page, reopened while any view follows a campaign. */

import { ROOT } from "./api";
import type { CampaignEvent, Moving } from "./types";

export interface Follower {
  event?: (event: CampaignEvent) => void;
  progress?: (moving: Moving) => void;
  ended?: () => void;
  /** Called when the connection is back: what was missed and is not sent again must be requested. */
  again?: () => void;
}

interface Message {
  campaign?: string;
  event?: CampaignEvent;
  progress?: Moving;
  ended?: boolean;
  error?: string;
}

const SILENT_MILLISECONDS = 40_000;
const FIRST_WAIT = 300;
const LONGEST_WAIT = 5_000;

let state = $state<"idle" | "connecting" | "open" | "lost">("idle");
const followers = new Map<string, Set<Follower>>();
const newest = new Map<string, number>();
let socket: WebSocket | null = null;
let wait = FIRST_WAIT;
let timer: ReturnType<typeof setTimeout> | undefined;
let watchdog: ReturnType<typeof setTimeout> | undefined;
let wasLost = false;

export const connection = {
  get state(): string {
    return state;
  },
};

/** Follows a campaign until the returned function is called. */
export function follow(campaign: string, follower: Follower): () => void {
  const known = followers.get(campaign);
  if (known) known.add(follower);
  else {
    followers.set(campaign, new Set([follower]));
    newest.delete(campaign);
    if (socket?.readyState === WebSocket.OPEN) tell({ follow: campaign });
  }
  connect();
  return () => {
    const left = followers.get(campaign);
    left?.delete(follower);
    if (left?.size === 0) {
      followers.delete(campaign);
      if (socket?.readyState === WebSocket.OPEN) tell({ unfollow: campaign });
    }
  };
}

/** Retries at once instead of waiting: after logging in, for example. */
export function reconnect(): void {
  wait = FIRST_WAIT;
  clearTimeout(timer);
  connect();
}

function connect(): void {
  if (socket !== null) return;
  clearTimeout(timer);
  if (followers.size === 0) {
    // No view waits for it any more.
    state = "idle";
    wasLost = false;
    return;
  }
  state = wasLost ? "lost" : "connecting";
  const opened = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}${ROOT}/live`);
  socket = opened;
  opened.onopen = () => {
    wait = FIRST_WAIT;
    state = "open";
    for (const campaign of followers.keys()) tell({ follow: campaign, after: newest.get(campaign) ?? 0 });
    if (wasLost) for (const each of followers.values()) for (const follower of each) follower.again?.();
    wasLost = false;
    watch();
  };
  opened.onmessage = (message) => {
    watch();
    take(JSON.parse(String(message.data)) as Message);
  };
  opened.onclose = () => {
    clearTimeout(watchdog);
    if (socket === opened) socket = null;
    if (followers.size === 0) {
      state = "idle";
      return;
    }
    wasLost = true;
    state = "lost";
    timer = setTimeout(connect, wait);
    wait = Math.min(LONGEST_WAIT, wait * 1.6);
  };
}

function watch(): void {
  clearTimeout(watchdog);
  watchdog = setTimeout(() => socket?.close(), SILENT_MILLISECONDS);
}

function tell(message: object): void {
  socket?.send(JSON.stringify(message));
}

function take(message: Message): void {
  const each = message.campaign === undefined ? undefined : followers.get(message.campaign);
  if (message.campaign === undefined || each === undefined) return;
  if (message.event?.id) newest.set(message.campaign, message.event.id);
  for (const follower of each) {
    if (message.event) follower.event?.(message.event);
    if (message.progress) follower.progress?.(message.progress);
    if (message.ended) follower.ended?.();
  }
}
