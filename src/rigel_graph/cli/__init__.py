"""The command line: runs one action for the given words and prints its result."""
