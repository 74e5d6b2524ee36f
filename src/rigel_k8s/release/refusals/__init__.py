"""Why a deploy is refused before its first write: all reasons at once, each with a way out.

`foresight` queries the cluster: `trials` are dry runs, `missing` are the missing rights out of
those that `rights` declares. `verdict` decides from the answers, with `admission` (pods); both
are pure.
"""
