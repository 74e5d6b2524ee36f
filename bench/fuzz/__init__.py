"""Checks and renders mutated Rigelfiles, and finds tracebacks and excessive use of resources."""
