/** The answers of the API that the page shows; see drivecal.contracts. */

export interface Cells {
  proposed: number;
  carried_over?: number;
  pending: number;
  requested: number;
  repeated: number;
  reused?: number;
  certified: number;
  simulated: number;
  failed: number;
  audited?: number;
  checked?: number;
  unrepeatable?: number;
}

export interface Progress {
  done: number;
  total: number;
  eta_seconds: number | null;
}

export interface ErrorRate {
  audited: number;
  different: number;
  wrong: number;
  upper_95: number | null;
  stopped: boolean;
  contradictions: number;
}

export interface Best {
  objective: number;
  parameters: Record<string, number>;
  scores: Record<string, number>;
  alternatives: number;
}

/** What moves while a campaign runs. */
export interface Moving {
  state: string;
  requested_action: string | null;
  degraded: string | null;
  stage: string | null;
  iteration: number | null;
  progress: Progress;
  cells: Cells;
  sensitivity_cells: Cells;
  robustness_cells: Partial<Cells>;
  validation_cells: Partial<Cells>;
  seconds: { wall: number; simulating: number };
}

export interface Specification {
  name?: string;
  weights?: Record<string, number>;
  optimizer?: { kind: string; population?: number; iterations?: number } | null;
  sensitivity?: Record<string, unknown> | null;
  reduction?: { mode: string; audit: number; max_error: number; certified?: boolean };
  robustness?: Record<string, unknown> | null;
  validation?: Record<string, unknown> | null;
  [more: string]: unknown;
}

export interface Campaign extends Moving {
  id: string;
  name: string;
  kind: string;
  error_rate: Record<string, ErrorRate>;
  best: Best | null;
  baseline: { objective: number | null; parameters: Record<string, number>; scores: Record<string, number | null> } | null;
  error: string | null;
  notes: string[];
  rerun_of: string | null;
  created_at: string | null;
  started_at: string | null;
  ended_at: string | null;
  spec: Specification;
  links: Record<string, string>;
}

export interface CampaignPage {
  items: Campaign[];
  next_cursor: string | null;
}

export interface CampaignEvent {
  id: number | null;
  kind: string;
  campaign: string;
  at: string;
  data: Record<string, unknown>;
}

export interface Generation {
  iteration: number;
  proposed: number;
  carried_over: number;
  requested: number;
  repeated: number;
  reused: number;
  certified: number;
  simulated: number;
  failed: number;
  audited: number;
  best: number | null;
  rating: number | null;
  mean: number | null;
  minimum: number | null;
  alternatives: number;
}

export interface Setup {
  evaluator: string;
  parameters: { name: string; unit: string; lower: number; upper: number; n_values: number; fixed: number | null }[];
  scenarios: { scenario: string; weight: number; fingerprint: string; driving_function: string; vehicle: string; simulator: string }[];
}

export interface InfluenceRow {
  scenario: string;
  parameter: string;
  influential: boolean;
  lower: number | null;
  upper: number | null;
  s_rel_intervals: (number | null)[] | null;
  mu: number | null;
  sigma: number | null;
  mu_star: number | null;
  unknown: boolean;
  unit: string | null;
  space_lower: number | null;
  space_upper: number | null;
}

export interface Solution {
  rank: number;
  objective: number;
  rating: number;
  parameters: Record<string, number>;
  scores: Record<string, number>;
  reused: string[];
  iteration: number;
  individual: number;
}

export interface Session {
  name: string | null;
  may_write: boolean;
}
