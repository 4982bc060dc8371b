"""Campaigns: what is asked for (`problem`), how it is worked through (`calibration`), and what carries it out (`dispatcher`)."""
