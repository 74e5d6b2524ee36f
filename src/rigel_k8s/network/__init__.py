"""How pods find each other: what a network mode adds to a pod, and which objects it needs; pure.

`options` become a `plan`, the same for all pods of a release; `mode` is what a mode may decide, and
`modes/` has them. `wiring` is what one of them adds to a pod, `dds` and `files` are what several
use. `multus/` installs and proves what macvlan needs, `preflight/` looks whether it will work.
"""
