"""The reference table: setups, parameter sets, runs, ratings, influence maps and reference keys."""
