"""Output of the commands: tables, progress, explanations."""
