"""Reading logs: what pods print now, and what Loki keeps of pods that are gone."""
