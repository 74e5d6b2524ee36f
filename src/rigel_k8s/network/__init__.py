"""How pods find each other: what a network mode adds to a pod, and which objects it needs; pure."""
