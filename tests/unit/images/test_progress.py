"""What is told of a build that runs."""

from __future__ import annotations

import pytest

from rigel_k8s.images.progress import PAUSE, Steps, step_of


@pytest.mark.parametrize(
    ("line", "step"),
    [
        ("STEP 3/7: RUN make", "3/7 RUN make"),
        ("[1/2] STEP 3/7: FROM a AS b", "3/7 FROM a AS b"),
        ("[linux/arm64] STEP 1/2: FROM scratch", "linux/arm64 1/2 FROM scratch"),
        ("#7 [3/7] RUN make", "3/7 RUN make"),
        ("#8 [stage-1 2/3] RUN a     b", "stage-1 2/3 RUN a b"),
        ("#8 [linux/arm64 2/3] RUN a", "linux/arm64 2/3 RUN a"),
        ("#8 0.5 [1/2] something", None),
        ("#8 [internal] load metadata", None),
        ("Reading package lists...", None),
    ],
)
def test_steps_are_found(line: str, step: str | None) -> None:
    """podman's and buildx's ways to begin a step are read."""
    assert step_of(line) == step


def test_long_commands_are_cut() -> None:
    """A step stays on one line of a terminal."""
    step = step_of(f"STEP 1/1: RUN {'x' * 500}")
    assert step is not None
    assert len(step) == 100


def test_steps_are_told_and_output_only_now_and_then() -> None:
    """Each step is told at once; of a long step's output one line now and then."""
    now, told = [0.0], list[str]()
    steps = Steps(told.append, clock=lambda: now[0])
    for line in ("noise before", "STEP 1/2: FROM a", "noise", "STEP 2/2: RUN b", "quick"):
        steps(line)
    now[0] = PAUSE
    steps("still at it")
    steps("quick again")
    assert told == ["1/2 FROM a", "2/2 RUN b", "2/2 still at it"]
