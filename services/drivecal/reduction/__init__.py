"""Scenario simulation reduction (Section III of the paper): which stored result may answer a cell. Pure."""
