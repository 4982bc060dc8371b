"""`drivecal demo`: the whole way from a submitted campaign to its result, on one machine, in minutes."""
