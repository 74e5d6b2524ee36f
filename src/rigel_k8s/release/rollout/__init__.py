"""Whether what was applied becomes ready, and why it does not.

`wait` waits, with what `view` sees. `readiness`, `causes` and `patience` decide, and are pure.
"""
