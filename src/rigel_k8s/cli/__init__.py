"""The command line: words to one action, its result to print."""
