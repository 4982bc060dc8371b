"""Certificates, i.e. proofs that a run would be bit-identical to a stored one: its sequence of decisions determines a run."""
