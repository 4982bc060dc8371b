"""Parts of tests: what several tests share."""
