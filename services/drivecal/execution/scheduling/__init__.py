"""The scheduler and its parts: a pure state machine without clock or I/O."""
