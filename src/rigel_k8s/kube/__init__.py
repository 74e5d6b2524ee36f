"""The Kubernetes API on plain dicts; the one room that speaks HTTP to a cluster."""
