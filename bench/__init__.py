"""Compares rigel with other tools for the same work; `./run bench`, docs/performance.md."""
