"""`rigel` on a real API server behind a proxy that injects faults, all drawn from a seed."""
