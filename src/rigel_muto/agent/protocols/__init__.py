"""The three ways in which commands arrive, each without any I/O."""
