"""Parts of tests: what the fault suite does to a server, and how it sees that nothing came of it."""
