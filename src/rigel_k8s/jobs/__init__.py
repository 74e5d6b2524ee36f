"""Job types, providers, and the runner of sequences; independent of what a job does."""
