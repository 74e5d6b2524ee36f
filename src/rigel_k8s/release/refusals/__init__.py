"""Why a deploy is refused before its first write: all reasons at once, each with a way out.

`foresight` queries the cluster, with dry runs of objects and of pods; `missing` are the rights that
it lacks, `needs` are machines and objects. `verdict` decides from the answers, and is pure.
"""
