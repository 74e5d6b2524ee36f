"""`python -m rigel_k8s`."""

from __future__ import annotations

from rigel_k8s.entry import main

if __name__ == "__main__":
    main(name="rigel-k8s")
