"""Why a deploy is refused before its first write: all reasons at once, each with a way out.

`foresight` asks the cluster, with `trials` (dry runs) and `rights`. `verdict` decides from the
answers, with `admission` and `quotas`, and is pure like them.
"""
