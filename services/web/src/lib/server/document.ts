/** The API's own description: its OpenAPI document. */

import type { Definitions } from "../forms/schema";
import { ask } from "./api.svelte";

/** The schemas of the API by name. */
export async function definitions(): Promise<Definitions> {
  const document = (await (await ask("/openapi.json", {}, "")).json()) as { components: { schemas: Definitions } };
  return document.components.schemas;
}
