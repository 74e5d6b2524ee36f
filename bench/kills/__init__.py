"""Commands that are killed at every write, and run again: `python -m bench.kills`."""
