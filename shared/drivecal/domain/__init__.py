"""The domain model: pure, frozen values without I/O, built on the standard library and numpy alone."""
