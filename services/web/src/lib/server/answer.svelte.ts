/** Answers of the server as views hold them. */

import { messageOf, reach } from "./api.svelte";

/** The last answer to a question, whether one is awaited, and why it failed. */
export class Answer<T> {
  value = $state.raw<T | null>(null);
  /** The reason of a failure, null without one. */
  error = $state.raw<unknown>(null);
  busy = $state(false);
  private asked = 0;
  private taken = 0;

  get problem(): string {
    return this.error === null ? "" : messageOf(this.error);
  }

  /** The answer to the newest question; null while it is awaited, and if it failed. */
  get current(): T | null {
    return this.busy || this.error !== null ? null : this.value;
  }

  /** Takes an answer when it comes, unless one to a later question has come before it; without a question there is no answer. */
  async take(question: Promise<T> | null): Promise<void> {
    const number = ++this.asked;
    this.busy = true;
    try {
      const value = await question;
      if (number > this.taken) [this.value, this.error, this.taken] = [value, null, number];
    } catch (error) {
      if (number > this.taken) [this.error, this.taken] = [error, number];
    }
    if (number === this.asked) this.busy = false;
  }
}

/** An answer whose question can be asked again. */
export interface Asked<T> extends Answer<T> {
  again: () => void;
}

interface Times<T> {
  /** Milliseconds between two questions while the page is in sight. */
  every?: number;
  /** Whether an answer is the last one. */
  until?: (value: T) => boolean;
  /** Milliseconds to wait for a further change of `on` before the question. */
  after?: number;
  on?: () => unknown;
}

/** An answer that is asked for when a view opens, and again when anything changes that the question reads, or `on`, and when the server is back. */
export function answerTo<T>(question: () => Promise<T> | null, { every, until, after, on }: Times<T> = {}): Asked<T> {
  const answer = new Answer<T>();
  const ask = (): void => void answer.take(question());
  $effect(() => {
    void reach.returns;
    on?.();
    if (after === undefined) {
      ask();
      return undefined;
    }
    answer.busy = true;
    const timer = setTimeout(ask, after);
    return () => clearTimeout(timer);
  });
  $effect(() => {
    if (every === undefined) return undefined;
    const timer = setInterval(() => {
      if (!document.hidden && !answer.busy && !(answer.value !== null && until?.(answer.value))) ask();
    }, every);
    return () => clearInterval(timer);
  });
  return Object.assign(answer, { again: ask });
}
