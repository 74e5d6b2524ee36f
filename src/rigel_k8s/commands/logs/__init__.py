"""Reading logs: of current pods, and of deleted pods from Loki."""
