"""Plug-ins: their protocols (`ports`), their discovery (`registry`) and the setups that they form (`setups`)."""
