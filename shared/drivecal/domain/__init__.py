"""What drivecal talks about: pure, frozen values without I/O, on the standard library and numpy alone."""
