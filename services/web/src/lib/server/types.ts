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
  stages: Record<string, Cells>;
  seconds: { wall: number; simulating: number };
}

export interface Specification {
  name?: string;
  weights?: Record<string, number>;
  optimizer?: { kind: string; population?: number; iterations?: number } | null;
  sensitivity?: Record<string, unknown> | null;
  reduction?: { mode: string; audit: number; max_error: number; certified?: boolean; confirm?: number };
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
  text: string;
  data: Record<string, unknown>;
}

/** Cells by outcome. */
interface Outcomes {
  requested: number;
  repeated: number;
  reused: number;
  certified: number;
  simulated: number;
  failed: number;
  audited: number;
}

export interface Generation extends Outcomes {
  iteration: number;
  proposed: number;
  carried_over: number;
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

export interface Session {
  name: string | null;
  may_write: boolean;
}

/** One run of a comparison: a campaign of its own. */
export interface ComparedRun {
  run: string;
  optimizer: string;
  population: number;
  seed: number;
  reduction: string;
  state: string;
  iterations: number;
  requested: number;
  simulations: number;
  confirmations: number;
  analysis: number;
  best: number | null;
  simulated_best: number | null;
  rating: number | null;
  alternatives: number;
  mean: number | null;
  converged_at: number | null;
  simulations_to_converge: number | null;
  success: boolean;
}

/** Table 5: the runs of one optimizer, population and reduction. */
export interface ComparedGroup {
  optimizer: string;
  population: number;
  reduction: string;
  seeds: number;
  best: number | null;
  mean: number | null;
  minimum: number | null;
  rating: number | null;
  alternatives: number | null;
  simulations: number | null;
  converged: number;
  iterations_to_converge: number | null;
  simulations_to_converge: number | null;
  successes: number;
}

/** Two runs that differ in the reduction alone. */
export interface ComparedPair {
  optimizer: string;
  population: number;
  seed: number;
  reduction: string;
  base: string;
  run: string;
  base_run: string;
  difference: number;
  simulations: number;
  base_simulations: number;
  saved: number;
}

export interface ReductionEffect {
  optimizer: string | null;
  population: number | null;
  reduction: string;
  base: string;
  pairs: number;
  mean_difference: number;
  lower_95: number | null;
  upper_95: number | null;
  better: number;
  equal: number;
  worse: number;
  sign_test: number;
  different_upper_95: number;
  simulations: number;
  base_simulations: number;
  saved_share: number;
}

/** What a campaign saved and what that cost; seconds of the workers' CPU time. */
export interface Accounting {
  sensitivity: { requested: number; simulated: number; seconds: number };
  map: { id: string; made_by: string | null; paid_here: boolean; runs: number; seconds: number } | null;
  scenarios: ScenarioAccount[];
  requested: number;
  answered_without_simulation: number;
  simulated: number;
  audited: number;
  share_without_simulation: number | null;
  share_reused: number | null;
  simulated_seconds: number;
  audited_seconds: number;
  repeated_saved_seconds: number;
  reused_saved_seconds: number;
  certified_saved_seconds: number;
  saved_seconds: number;
  net_seconds: number;
  map_net_seconds: number | null;
  break_even: { requested_cells: number | null; campaigns: number | null; reruns: number | null } | null;
  sentence: string;
}

export interface ScenarioAccount extends Outcomes {
  scenario: string;
  confirmed: number;
  mean_seconds: number | null;
  simulated_seconds: number;
  audited_seconds: number;
  repeated_saved_seconds: number;
  reused_saved_seconds: number;
  certified_saved_seconds: number;
  proved: number;
  proved_different: number;
  proved_wrong: number;
}

export interface Study {
  campaign: string;
  name: string;
  stage: "robustness" | "validation";
  state: string;
  settings: Record<string, unknown>;
  ended_at: string | null;
}

export interface BoxTrial {
  box: number;
  radius: number;
  holds: boolean;
  deviations: Record<string, number | null>;
}

export interface RobustRow {
  rank: number;
  objective: number | null;
  rating: number | null;
  degree: number;
  at_least: boolean;
  radius: number;
  recommended: boolean;
  reason: string | null;
  region: number;
  to_worse: number | null;
  parameters: Record<string, number>;
  trials: BoxTrial[];
}

export interface ValidRow {
  scenario: string;
  reducible: number;
  effects: number;
  covered: number;
  drawn: number;
  bases: number;
  references: number;
  compared: number;
  wrong: number;
  different: number;
  error_rate: number | null;
  lower_95: number | null;
  upper_95: number | null;
  histogram: Record<string, number>;
}
