"""HTTP: authentication, limits, bodies, errors, connections."""
