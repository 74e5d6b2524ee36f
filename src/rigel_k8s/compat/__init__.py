"""This package inside Rigel 0.3: job types as Rigel's plugins, and `rigel` handing over to Rigel.

Rigel is never imported from here unless it has been imported already, or `rigel run` is typed where
it is installed. It uses the interface of job types and is independent of what they do.
"""

from __future__ import annotations

from rigel_k8s.compat.handover import handover

__all__ = ["handover"]
