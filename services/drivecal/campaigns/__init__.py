"""Campaigns: what is asked for (`problem`) and how it is worked through, stage by stage (`staged`)."""
