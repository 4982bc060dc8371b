/** What the page asks the server. Every path is relative to `/api/v1`. */

import type { FieldProblem } from "./problems";

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

let refused: () => void = () => undefined;

/** What to do when the server asks for a token. */
export function whenRefused(handler: () => void): void {
  refused = handler;
}

/** Asks the server. Throws a Refusal for every error status; 401 asks for a token first. */
export async function ask(path: string, options: RequestInit = {}, root = ROOT): Promise<Response> {
  let answer: Response;
  try {
    answer = await fetch(root + path, { credentials: "same-origin", ...options });
  } catch (error) {
    if (error instanceof DOMException && error.name === "AbortError") throw error;
    throw new Refusal(0, "The server cannot be reached.");
  }
  if (answer.ok || answer.status === 304) return answer;
  if (answer.status === 401) refused();
  throw await refusal(answer);
}

async function refusal(answer: Response): Promise<Refusal> {
  try {
    const body = (await answer.json()) as { detail?: string; title?: string; errors?: FieldProblem[] };
    return new Refusal(answer.status, body.detail ?? body.title ?? `The server answered ${answer.status}.`, body.errors ?? []);
  } catch {
    return new Refusal(answer.status, `The server answered ${answer.status}.`);
  }
}

export async function get<T>(path: string, signal?: AbortSignal): Promise<T> {
  return (await (await ask(path, signal ? { signal } : {})).json()) as T;
}

export async function send<T>(method: "POST" | "DELETE", path: string, body?: unknown, headers: Record<string, string> = {}): Promise<T> {
  const options: RequestInit = { method, headers: { ...headers } };
  if (body !== undefined) {
    options.body = JSON.stringify(body);
    options.headers = { ...headers, "Content-Type": "application/json" };
  }
  const answer = await ask(path, options);
  return (answer.status === 204 ? undefined : await answer.json()) as T;
}

/** All items of a list that comes in pages. */
export async function all<T>(path: string, signal?: AbortSignal, most = 20_000): Promise<T[]> {
  const items: T[] = [];
  let cursor: string | null = null;
  do {
    const joint = path.includes("?") ? "&" : "?";
    const page: { items: T[]; next_cursor: string | null } = await get(
      `${path}${joint}limit=1000${cursor === null ? "" : `&cursor=${encodeURIComponent(cursor)}`}`,
      signal,
    );
    items.push(...page.items);
    cursor = page.next_cursor;
  } while (cursor !== null && items.length < most);
  return items;
}

/** Asks again and again with the tag of the last answer; `undefined` where nothing changed. */
export class Tagged<T> {
  private tag: string | null = null;
  constructor(private readonly path: string) {}

  async next(signal?: AbortSignal): Promise<T | undefined> {
    const options: RequestInit = { cache: "no-store", headers: this.tag === null ? {} : { "If-None-Match": this.tag } };
    if (signal) options.signal = signal;
    const answer = await ask(this.path, options);
    if (answer.status === 304) return undefined;
    this.tag = answer.headers.get("ETag");
    return (await answer.json()) as T;
  }
}
