"""SUMO at work: the only place that imports libsumo."""
