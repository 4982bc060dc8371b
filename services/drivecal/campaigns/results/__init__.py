"""Results of a campaign on demand: explanations, alternative optima, checks of stored rows."""
