"""The machine that `rigel` runs on: files, programs, connections, and what may be used of them."""
