"""Interface to SUMO, the only package that imports libsumo."""
