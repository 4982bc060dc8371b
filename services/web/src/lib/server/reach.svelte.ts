/** Whether the server can be reached. While it cannot, the page retries; views read what they missed when it is back. */

import { ask, whenHeard } from "./api";

const WAIT_MILLISECONDS = 1_000;

let lost = $state(false);
let returns = $state(0);
let timer: ReturnType<typeof setTimeout> | undefined;

export const reach = {
  get lost(): boolean {
    return lost;
  },
  /** How often it came back, or a user did: what reads this in an effect runs again then. */
  get returns(): number {
    return returns;
  },
};

/** Has views read what they missed: after a login. */
export function returned(): void {
  returns += 1;
}

whenHeard((answered) => {
  clearTimeout(timer);
  if (answered && lost) returned();
  lost = !answered;
  if (lost) timer = setTimeout(() => void ask("/healthz", { cache: "no-store" }, "").catch(() => undefined), WAIT_MILLISECONDS);
});
