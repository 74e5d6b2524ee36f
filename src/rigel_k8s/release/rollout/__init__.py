"""Whether what was applied becomes ready, and if not, why.

`wait` waits, with what `view` sees, `claims` explains and `unprobed` checks. `readiness`, `causes`,
`crashes`, `patience` and `surroundings` decide, and are pure.
"""
