"""The REST API: validates requests, stores them, and reads the dispatcher's results. It computes and simulates nothing."""
