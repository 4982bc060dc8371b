/** The API's own description: its OpenAPI document. */

import type { Definitions } from "../forms/schema";
import { Refusal, ask } from "./api.svelte";

let reading: Promise<Definitions> | null = null;

/** The schemas of the API by name, read once. */
export function definitions(): Promise<Definitions> {
  reading ??= ask("/openapi.json", {}, "")
    .then((answer) => answer.json())
    .then((document: { components: { schemas: Definitions } }) => document.components.schemas)
    .catch((error: unknown) => {
      reading = null;
      throw error instanceof Refusal ? error : new Refusal(0, `The API's description cannot be read: ${String(error)}`);
    });
  return reading;
}
