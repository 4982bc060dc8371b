"""Order among campaigns: labels, archive, deletion, saved views."""
