"""Traffic from files: SUMO route files and OpenSCENARIO files become the traffic of a scenario of kind `highway`."""
