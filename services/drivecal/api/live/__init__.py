"""Live answers: event streams, cached responses, the health of the dispatcher."""
