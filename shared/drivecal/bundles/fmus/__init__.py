"""FMUs of bundles: what they say of their variables, and whether a problem fits."""
