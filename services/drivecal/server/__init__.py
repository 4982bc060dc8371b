"""The processes of the coordinator: started, supervised and ended together."""
