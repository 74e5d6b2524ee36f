"""Job types, providers, and the runner of sequences; it knows nothing of what a job does."""
