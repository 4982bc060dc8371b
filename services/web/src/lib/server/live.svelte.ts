/** The live connection of a campaign: a WebSocket that is opened again while a view follows. */

import { ROOT, isReport } from "./api.svelte";
import type { CampaignEvent, Moving } from "./types";

export interface Follower {
  event: (event: CampaignEvent) => void;
  progress: (moving: Moving) => void;
  ended: () => void;
  /** The connection is back: what was missed and is not sent again must be requested. */
  again: () => void;
}

interface Message {
  event?: CampaignEvent;
  progress?: Moving;
  ended?: boolean;
}

const SILENT_MILLISECONDS = 40_000;
const FIRST_WAIT = 300;
const LONGEST_WAIT = 5_000;

let lost = $state(false);
let retry: () => void = () => undefined;

export const connection = {
  get lost(): boolean {
    return lost;
  },
};

/** Retries at once instead of waiting: after logging in, for example. */
export function reconnect(): void {
  retry();
}

/** Follows a campaign until the returned function is called. */
export function follow(campaign: string, follower: Follower): () => void {
  if (isReport) return () => undefined;
  let [socket, wait, newest, followed]: [WebSocket | null, number, number, boolean] = [null, FIRST_WAIT, 0, true];
  let timer: ReturnType<typeof setTimeout> | undefined;
  let watchdog: ReturnType<typeof setTimeout> | undefined;

  const watch = (): void => {
    clearTimeout(watchdog);
    watchdog = setTimeout(() => socket?.close(), SILENT_MILLISECONDS);
  };
  const connect = (): void => {
    clearTimeout(timer);
    if (socket !== null || !followed) return;
    const address = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}${ROOT}/live`;
    const opened = (socket = new WebSocket(`${address}?campaign=${encodeURIComponent(campaign)}&after=${newest}`));
    opened.onopen = () => {
      if (lost) follower.again();
      [wait, lost] = [FIRST_WAIT, false];
      watch();
    };
    opened.onmessage = (message) => {
      watch();
      const { event, progress, ended } = JSON.parse(String(message.data)) as Message;
      if (!followed) return;
      if (event?.id) newest = event.id;
      if (event) follower.event(event);
      if (progress) follower.progress(progress);
      if (ended) follower.ended();
    };
    opened.onclose = () => {
      clearTimeout(watchdog);
      socket = null;
      lost = followed;
      if (followed) timer = setTimeout(connect, wait);
      wait = Math.min(LONGEST_WAIT, wait * 1.6);
    };
  };
  retry = () => {
    wait = FIRST_WAIT;
    connect();
  };
  connect();
  return () => {
    [followed, lost] = [false, false];
    clearTimeout(timer);
    socket?.close();
  };
}
