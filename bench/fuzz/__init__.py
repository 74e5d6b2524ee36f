"""Mutated Rigelfiles, checked and rendered: what ends in a traceback, or takes too much."""
