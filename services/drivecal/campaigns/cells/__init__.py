"""The cells of a campaign: planned against the reference table, tracked until their answers are stored."""
