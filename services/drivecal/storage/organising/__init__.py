"""What users do to keep campaigns in order: labels, archive, deletion, saved views."""
