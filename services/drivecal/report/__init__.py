"""The report of a campaign: the paper's figures, tables and one page that a colleague can read and print."""

PAGE = "index.html"
"""The file of a report to begin with."""
