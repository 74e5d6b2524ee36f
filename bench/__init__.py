"""How rigel compares with what a user would pick instead; `./run bench`, docs/performance.md."""
