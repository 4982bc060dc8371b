"""The stages of a campaign, in their order, and the loop that runs them."""
