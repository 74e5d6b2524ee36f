"""What a container runs, as a value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import attrs


@attrs.frozen
class Command:
    """A container's command and args (None: the image's own), and its parameter files.

    Attributes:
        files: name to text, to be mounted at PARAMETERS_PATH.
        start: the words of start.sh, which `put_start_before` puts before all others; empty
            if there is nothing to prepare.
    """

    command: Sequence[str] | None = None
    args: Sequence[str] | None = None
    files: Mapping[str, str] = attrs.field(factory=dict)
    start: Sequence[str] = ()
