"""The stages of a campaign, in order, and the loop that runs them."""
