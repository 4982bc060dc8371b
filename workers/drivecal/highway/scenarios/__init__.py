"""The built-in scenario catalogue: definitions, SUMO networks, and the script that builds the networks."""
