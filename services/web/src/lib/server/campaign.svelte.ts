/** One campaign as it is now: read once, moved on by what its event stream tells, read again where more than its progress changed. */

import { ROOT, Refusal, Tagged, all, isReport } from "./api.svelte";
import type { Campaign, CampaignEvent, Generation, Moving } from "./types";

export const MOST_EVENTS = 300;
const READ_AGAIN_MILLISECONDS = 1_000;
/** After an event: a fast search has several iterations a second. */
const APART_MILLISECONDS = 300;
/** All kinds of events: an `EventSource` listens to each by its name. */
const KINDS = ["queued", "running", "pausing", "paused", "resuming", "resumed", "cancelling", "cancelled", "succeeded", "failed", "degraded", "recovered", "stalled", "stage", "phase", "influence_map", "generation", "best", "baseline", "lot_rejected", "note"];
/** After these the answer of the campaign itself holds more than its progress. */
const TELLING = new Set(["best", "baseline", "lot_rejected", "note", "influence_map", "stage", "generation", "failed", "succeeded", "cancelled", "queued", "paused"]);

export class CampaignState {
  campaign = $state.raw<Campaign | null>(null);
  events = $state.raw<CampaignEvent[]>([]);
  generations = $state.raw<Generation[]>([]);
  problem = $state<Refusal | null>(null);

  private readonly tagged: Tagged<Campaign>;
  private timer: ReturnType<typeof setTimeout> | undefined;
  /** When the timer rings. */
  private due = Infinity;
  private reading = false;
  private knownGenerations = -1;

  constructor(readonly id: string) {
    this.tagged = new Tagged<Campaign>(`/campaigns/${encodeURIComponent(id)}`);
  }

  start(): () => void {
    void this.read();
    const leave = follow(this.id, {
      event: (event) => this.take(event),
      progress: (moving) => {
        // An ended campaign moves no more: what was on its way when its end was read is older.
        if (this.campaign?.ended_at === null) this.campaign = { ...this.campaign, ...moving };
      },
      over: () => this.soon(0),
      isOver: () => this.problem?.status === 404 || (this.campaign !== null && this.campaign.ended_at !== null),
    });
    // The answer's tag makes this cheap; it is there for what no event tells, such as audits, and notices that the server is away.
    const tick = setInterval(() => {
      if (!document.hidden && this.problem?.status !== 404) this.soon(0);
    }, 5_000);
    return () => {
      leave();
      clearTimeout(this.timer);
      clearInterval(tick);
    };
  }

  /** Reads it again within a second. Events in quick succession share an answer, and postpone none. */
  soon(milliseconds = READ_AGAIN_MILLISECONDS): void {
    const due = performance.now() + milliseconds;
    if (due >= this.due) return;
    clearTimeout(this.timer);
    this.due = due;
    this.timer = setTimeout(() => {
      this.due = Infinity;
      void this.read();
    }, milliseconds);
  }

  private take(event: CampaignEvent): void {
    if (event.id !== null && this.events.some((known) => known.id === event.id)) return;
    this.events = [...this.events, event].slice(-MOST_EVENTS);
    // an ended campaign is not degraded, and no event says so
    if (this.campaign?.ended_at === null && ["degraded", "recovered"].includes(event.kind)) this.campaign = { ...this.campaign, degraded: event.kind === "degraded" ? String(event.data["reason"] ?? "degraded") : null };
    if (TELLING.has(event.kind)) this.soon(APART_MILLISECONDS);
  }

  private async read(): Promise<void> {
    if (this.reading) {
      this.soon(); // something changed while the answer was on its way
      return;
    }
    this.reading = true;
    try {
      const next = await this.tagged.next();
      if (next) this.campaign = next;
      const { kind, ended_at, iteration, cells } = this.campaign ?? {};
      const known = ended_at === null ? (iteration ?? -1) : Infinity;
      if (kind === "calibration" && cells && cells.proposed > 0 && known !== this.knownGenerations) {
        this.generations = await all<Generation>(`/campaigns/${this.id}/generations`);
        this.knownGenerations = known;
      }
      this.problem = null;
    } catch (error) {
      // While the server is away, the page keeps what it knows.
      if (error instanceof Refusal && (this.campaign === null || error.status === 404)) this.problem = error;
    } finally {
      this.reading = false;
    }
  }
}

interface Follower {
  event: (event: CampaignEvent) => void;
  progress: (moving: Moving) => void;
  /** The stream ended or broke off: what it did not tell must be requested. */
  over: () => void;
  /** Nothing follows any more. */
  isOver: () => boolean;
}

const AGAIN_MILLISECONDS = 2_000;

/** Follows a campaign until the returned function is called. Browsers open six connections to a server: a tab in the background has none. */
function follow(campaign: string, follower: Follower): () => void {
  if (isReport) return () => undefined;
  let newest = 0;
  let source: EventSource | undefined;
  let timer: ReturnType<typeof setTimeout> | undefined;

  const leave = (): void => {
    clearTimeout(timer);
    source?.close();
  };
  const connect = (): void => {
    leave();
    if (document.hidden) return;
    const opened = (source = new EventSource(`${ROOT}/campaigns/${encodeURIComponent(campaign)}/events?last_event_id=${newest}`));
    opened.addEventListener("progress", ({ data }: MessageEvent<string>) => follower.progress(JSON.parse(data) as Moving));
    for (const kind of KINDS) {
      opened.addEventListener(kind, ({ data }: MessageEvent<string>) => {
        const event = JSON.parse(data) as CampaignEvent;
        newest = event.id ?? newest;
        follower.event(event);
      });
    }
    opened.onerror = () => {
      follower.over();
      if (opened.readyState === EventSource.CLOSED) timer = setTimeout(() => { if (!follower.isOver()) connect(); }, AGAIN_MILLISECONDS); // else the browser tries again
    };
  };
  document.addEventListener("visibilitychange", connect);
  connect();
  return () => {
    document.removeEventListener("visibilitychange", connect);
    leave();
  };
}
