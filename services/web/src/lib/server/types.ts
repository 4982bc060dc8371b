/** The API's answers: `schema.d.ts` is generated from its OpenAPI document by `make check`; here is what the page knows more exactly. */

import type { Campaign as Answer, CampaignProgress } from "../../../schema";

export type * from "../../../schema";

interface Vehicle {
  model?: string;
  parameters?: Record<string, number>;
}

/** A campaign or an evaluation as it was submitted. */
export interface Specification {
  weights?: Record<string, number>;
  optimizer?: { kind: string; population?: number; iterations?: number } | null;
  sensitivity?: Record<string, unknown> | null;
  reduction?: { mode: string; audit: number; max_error: number; certified?: boolean; confirm?: number; tolerance?: number | null; limit?: number };
  robustness?: Record<string, unknown> | null;
  validation?: Record<string, unknown> | null;
  vehicle?: Vehicle;
  variants?: Record<string, { vehicle?: Vehicle }>;
  [more: string]: unknown;
}

export type Campaign = Omit<Answer, "spec"> & { spec: Specification };

/** What changes while a campaign runs. */
export type Moving = Pick<CampaignProgress, "state" | "requested_action" | "degraded" | "waiting" | "stage" | "iteration" | "progress" | "cells" | "stages" | "seconds">;
