"""The REST API: validates, stores what is asked for, and reads back what the dispatcher found. It computes and simulates nothing."""
