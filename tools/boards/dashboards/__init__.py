"""One module for each dashboard, found by listing this directory; each has a function `board`."""
