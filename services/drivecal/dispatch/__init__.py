"""The process that carries campaigns out."""
