"""The review sheet: one page about a chosen set, to check, print and sign."""
