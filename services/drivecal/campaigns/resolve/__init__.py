"""Resolves a submitted specification against the installed plug-ins: problem, search space, influence maps."""
