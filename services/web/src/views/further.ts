/** Views that the first one does without: they are fetched behind it, so that they open at once, also while the server is away. */

import "./Compare.svelte";
import "./Comparison.svelte";
import "./Evaluation.svelte";
import "./Evaluations.svelte";
import "./Front.svelte";
import "./Problem.svelte";
import "./Problems.svelte";
import "./Ranking.svelte";
import "./Submit.svelte";
import "./Workers.svelte";
import "../parts/CommandPalette.svelte";
import "../parts/charts/Beside.svelte";
import "../parts/front/FrontCard.svelte";
