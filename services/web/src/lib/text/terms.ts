/** Terms of the page with their meanings: each is the beginning of its entry in the glossary of the documentation (`docs/pages/concepts/glossary.md`). */

import { capital } from "./format";
import { MEANING } from "./words";

export const TERMS = {
  audit: "A cell that could have been reused, and was simulated as a check.",
  cell: "A parameter set in a scenario.",
  confirmation: "After the search, copied and predicted scores of the best set are simulated.",
  "degree-of-robustness": "The number of boxes around the nominal vehicle, each wider than the last, in which a set keeps its scores.",
  "influence-map": "Says per scenario where a parameter can change the score.",
  knee: "The set of a front that gives the most for what it costs: a little more of one objective costs much of another from there on.",
  lot: "Answers of a batch that are inspected together: a random sample is simulated.",
  "net-saving": "The CPU time, or wall-clock time if simulators wait, of the simulations that were not needed, less the time of the analysis and the predictor.",
  prediction: "A score that a model of earlier runs gives in the place of a simulation, released after a sample of its lot was simulated.",
  r_err: "Wrong answers among the compared ones.",
  reference: "A stored run that answers for a set which differs only where the influence map says that it does not matter.",
  released: "Counted as an answer without a simulation, because the sample of its lot had few errors.",
  s_rel: "The sensitivity of a score to a parameter within an interval, as a share of the score's range.",
  sample: "The cells of a lot that are drawn at random and simulated, to judge all of its answers.",
  tolerance: "The difference of two scores that does not matter to you.",
} as const;

export type Word = keyof typeof TERMS | keyof typeof MEANING;

/** A sentence: of a term, or of an outcome of cells. */
export function meaningOf(word: Word): string {
  if (word in TERMS) return TERMS[word as keyof typeof TERMS];
  return `${capital(MEANING[word as keyof typeof MEANING])}.`;
}

/** The address in the glossary; outcomes stand at the cells. */
export function glossary(word: Word): string {
  return `/help/concepts/glossary.html#${word in TERMS ? word : "cell"}`;
}

/** How texts of the server and of settings write the terms; code in backticks is none. */
const WRITTEN = /`[^`]*`|\b(?:influence map|lot|audit|reference|released|sample(?= of each lot)|knee)(?:s|ed)?\b/gi;

export interface Piece {
  text: string;
  /** The term that the text stands for. */
  word?: Word;
}

/** Texts in pieces, with each term marked where it is met first. */
export function explained(texts: readonly string[]): Piece[][] {
  const known = new Set<string>();
  return texts.map((text) => {
    const pieces: Piece[] = [];
    let from = 0;
    for (const { 0: found, index } of text.matchAll(WRITTEN)) {
      const word = found.toLowerCase().replace(/^(audit|lot|reference|influence map|knee)(s|ed)$/, "$1").replace(" ", "-");
      if (found.startsWith("`") || known.has(word)) continue;
      known.add(word);
      pieces.push({ text: text.slice(from, index) }, { text: found, word: word as Word });
      from = index + found.length;
    }
    return [...pieces, { text: text.slice(from) }];
  });
}
