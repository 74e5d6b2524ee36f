"""The observability stack as objects: files/programs/ has a file for each program; pure."""
