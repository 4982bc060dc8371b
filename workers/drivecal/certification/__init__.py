"""Proofs that a run would be bit-identical to a stored one: a run is determined by its sequence of decisions."""
