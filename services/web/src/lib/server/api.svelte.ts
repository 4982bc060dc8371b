/** What the page asks the server. Every path is relative to `/api/v1`. */

import type { Definitions } from "../forms/schema";
import type { Campaign, CampaignPage, FieldProblem, ProblemDocument } from "./types";

export const ROOT = "/api/v1";

/** A refusal, in the words of the server (RFC 9457). */
export class Refusal extends Error {
  constructor(
    readonly status: number,
    detail: string,
    readonly fields: readonly FieldProblem[] = [],
  ) {
    super(detail);
  }
}

/** What went wrong, for people. */
export function messageOf(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}

/** A report is this page in a file, with what the server had answered (`drivecal.client.report`). Null on a server's page. */
const kept = typeof document === "undefined" ? null : document.getElementById("answers");
const answers = kept === null ? null : (JSON.parse(kept.textContent ?? "{}") as Record<string, string | undefined>);
export const isReport = answers !== null;

/** An answer of a report. Throws a Refusal if it does not hold it. */
function told(path: string, from: Record<string, string | undefined>): Response {
  const body = from[path.replace(/\?$/, "")];
  if (body === undefined) throw new Refusal(404, "The report does not hold this; a server does.");
  return new Response(body);
}

let refused: () => void = () => undefined;

/** What to do when the server asks for a token. */
export function whenRefused(handler: () => void): void {
  refused = handler;
}

/** The server asks for a token: nothing else is asked of it meanwhile. */
let shut = false;
const SESSION = "/session";

const RETRY_MILLISECONDS = 1_000;
let timer: ReturnType<typeof setTimeout> | undefined;

/** Whether the server cannot be reached, so that the page retries, and how often it came back, or a user did: what reads this in an effect runs again then. */
export const reach = $state({ lost: false, returns: 0 });

function heard(answered: boolean): void {
  clearTimeout(timer);
  if (answered && reach.lost) reach.returns += 1;
  reach.lost = !answered;
  if (reach.lost) timer = setTimeout(() => void ask("/healthz", { cache: "no-store" }, "").catch(() => undefined), RETRY_MILLISECONDS);
}

/** Whether a request failed because the server cannot be reached. */
export function isUnreached(error: unknown): boolean {
  return error instanceof Refusal && error.status === 0;
}

/** Asks the server. Throws a Refusal for every error status; 401 asks for a token first. */
export async function ask(path: string, options: RequestInit = {}, root = ROOT): Promise<Response> {
  if (answers !== null) return told(path, answers);
  if (shut && root === ROOT && path !== SESSION) throw new Refusal(401, "The session has ended.");
  let answer: Response;
  try {
    answer = await fetch(root + path, { credentials: "same-origin", ...options });
  } catch (error) {
    if (error instanceof DOMException && error.name === "AbortError") throw error;
    heard(false);
    throw new Refusal(0, "The server cannot be reached.");
  }
  heard(true);
  if (answer.ok && path === SESSION) shut = false;
  if (answer.ok || answer.status === 304) return answer;
  if (answer.status === 401 && !new Headers(options.headers).has("Authorization")) {
    shut = true;
    refused();
  }
  throw await refusal(answer);
}

async function refusal(answer: Response): Promise<Refusal> {
  try {
    const body = (await answer.json()) as Partial<ProblemDocument>;
    return new Refusal(answer.status, body.detail ?? body.title ?? `The server answered ${answer.status}.`, body.errors ?? []);
  } catch {
    return new Refusal(answer.status, `The server answered ${answer.status}.`);
  }
}

export async function get<T>(path: string, signal?: AbortSignal): Promise<T> {
  return (await (await ask(path, signal ? { signal } : {})).json()) as T;
}

export async function send<T>(method: "POST" | "PATCH" | "DELETE", path: string, body?: unknown, headers: Record<string, string> = {}): Promise<T> {
  const content = body === undefined ? {} : { body: JSON.stringify(body), headers: { ...headers, "Content-Type": "application/json" } };
  const answer = await ask(path, { method, headers, ...content });
  return (answer.status === 204 ? undefined : await answer.json()) as T;
}

/** The schemas of the API by name, from its OpenAPI document. */
export async function definitions(): Promise<Definitions> {
  const document = (await (await ask("/openapi.json", {}, "")).json()) as { components: { schemas: Definitions } };
  return document.components.schemas;
}

let starting = { content: "", key: "" };

/** Starts something. The same content has the same key until it has started: pressing twice, or again after a broken connection, starts one. */
export async function start<T>(path: string, body: unknown): Promise<T> {
  const content = path + JSON.stringify(body);
  // `crypto.randomUUID` exists on https and localhost alone
  if (starting.content !== content) starting = { content, key: Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("") };
  const made = await send<T>("POST", path, body, { "Idempotency-Key": starting.key });
  if (starting.content === content) starting = { content: "", key: "" };
  return made;
}

/** All items of a list that comes in pages. */
export async function all<T>(path: string): Promise<T[]> {
  const items: T[] = [];
  let cursor: string | null = null;
  do {
    const query = new URLSearchParams({ limit: "1000", ...(cursor === null ? {} : { cursor }) });
    const page: { items: T[]; next_cursor: string | null } = await get(`${path}?${query}`);
    items.push(...page.items);
    cursor = page.next_cursor;
  } while (cursor !== null);
  return items;
}

/** Asks again and again with the tag of the last answer; `undefined` if nothing changed. */
export class Tagged<T> {
  /** The last answer. */
  value: T | null = null;
  private tag: string | null = null;
  constructor(private readonly path: string) {}

  async next(): Promise<T | undefined> {
    const answer = await ask(this.path, { cache: "no-store", headers: this.tag === null ? {} : { "If-None-Match": this.tag } });
    if (answer.status === 304) return undefined;
    this.value = (await answer.json()) as T;
    this.tag = answer.headers.get("ETag"); // an answer that broke off is asked for again
    return this.value;
  }
}

/** The campaigns of a filter as the server lists them. */
export class CampaignList {
  private held = new Map<string, Tagged<CampaignPage>>();

  /** `path`: the request of the newest page. */
  constructor(private readonly path: string) {}

  /** Reads the newest pages: each begins where the page before ends now, and unchanged pages are not sent again. `goesOn`: the server has older campaigns. */
  async read(pages: number): Promise<{ items: Campaign[]; goesOn: boolean }> {
    const held = new Map<string, Tagged<CampaignPage>>();
    const items: Campaign[] = [];
    let cursor: string | null = null;
    for (let number = 0; number < pages && (number === 0 || cursor !== null); number++) {
      const path: string = cursor === null ? this.path : `${this.path}&cursor=${encodeURIComponent(cursor)}`;
      const page: Tagged<CampaignPage> = this.held.get(path) ?? new Tagged<CampaignPage>(path);
      held.set(path, page);
      await page.next();
      items.push(...(page.value?.items ?? []));
      cursor = page.value?.next_cursor ?? null;
    }
    this.held = held;
    return { items, goesOn: cursor !== null };
  }
}
