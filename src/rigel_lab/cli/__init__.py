"""The words of `rigel cluster` and `rigel image`; the one place here that knows the core's cli."""
