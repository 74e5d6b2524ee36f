"""The observability stack as objects, one module a program; pure."""
