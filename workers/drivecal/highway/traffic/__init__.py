"""SUMO of the built-in motorway: its vehicles, and where they are on the road."""
