"""`python -m rigel_k8s`."""

from __future__ import annotations

import sys

if not getattr(sys.flags, "safe_path", False):
    # Python puts the working directory first; a file beside a Rigelfile could replace a library.
    del sys.path[0]

from rigel_k8s.entry import main

if __name__ == "__main__":
    main(name="rigel-k8s")
