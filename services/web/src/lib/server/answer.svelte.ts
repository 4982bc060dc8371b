/** Answers of the server as views hold them. */

import { messageOf } from "./api";
import { reach } from "./reach.svelte";

/** The last answer to a question, whether one is awaited, and why it failed. */
export class Answer<T> {
  value = $state.raw<T | null>(null);
  problem = $state("");
  busy = $state(false);
  private asked = 0;
  private taken = 0;

  /** Takes an answer when it comes, unless one to a later question has come before it; without a question there is no answer. */
  async take(question: Promise<T> | null): Promise<void> {
    const number = ++this.asked;
    this.busy = true;
    try {
      const value = await question;
      if (number > this.taken) [this.value, this.problem, this.taken] = [value, "", number];
    } catch (error) {
      if (number > this.taken) [this.problem, this.taken] = [messageOf(error), number];
    }
    if (number === this.asked) this.busy = false;
  }
}

/** An answer that is asked for when a view opens, and again when anything changes that the question reads, or the server is back. */
export function answerTo<T>(question: () => Promise<T> | null): Answer<T> {
  const answer = new Answer<T>();
  $effect(() => {
    void reach.returns;
    void answer.take(question());
  });
  return answer;
}
