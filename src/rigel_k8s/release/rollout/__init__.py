"""Whether what was applied becomes ready, and why it does not.

`wait` waits, with what `view` sees, `claims` explains and `unprobed` looks at. `readiness`,
`causes`, `crashes`, `patience` and `surroundings` decide, and are pure.
"""
