"""What is told of a build that runs, and of one that fails."""

from __future__ import annotations

import pytest

from rigel_build.progress import MOST_LINES, PAUSE, Steps, failure, step_of


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


#: Without empty lines, as they come; two steps at once, the first of them fails.
BUILDX = """\
#0 building with "default" instance using docker driver
#1 [internal] load build definition from Dockerfile
#1 transferring dockerfile: 120B done
#1 DONE 0.0s
#5 [app 2/3] RUN make
#5 0.312 cc -c main.c
#5 0.401 main.c:1:1: error: unknown type name 'x'
#5 ...
#6 [tools 2/2] RUN apt-get install -y git
#6 0.500 Reading package lists...
#6 ...
#5 [app 2/3] RUN make
#5 0.610 cc -c other.c
#5 0.700 #define is no step
#5 0.712 make: *** [Makefile:2: all] Error 1
#5 ERROR: process "/bin/sh -c make" did not complete successfully: exit code: 2
#6 [tools 2/2] RUN apt-get install -y git
#6 CANCELED
------
 > [app 2/3] RUN make:
0.712 make: *** [Makefile:2: all] Error 1
------
Dockerfile:2
--------------------
   1 |     FROM debian AS app
   2 | >>> RUN make
--------------------
ERROR: failed to solve: process "/bin/sh -c make" did not complete successfully: exit code: 2
""".splitlines()

#: Of podman 4.3; only the second platform fails.
PODMAN = """\
[linux/amd64] STEP 1/4: FROM debian
[linux/amd64] STEP 2/4: RUN echo "a" && make
cc -c main.c
--> a961ea8e8c0
[linux/arm64] STEP 1/4: FROM debian
[linux/arm64] STEP 2/4: RUN echo "a" && make
main.c:1:1: error: unknown type name 'x'
make: *** [Makefile:2: all] Error 1
Error: a word of make's own
subprocess exited with status 2
[linux/amd64] STEP 3/4: RUN echo fine
fine
--> 2689dc8a459
Error: building at STEP "RUN echo "a" && make": exit status 2
""".splitlines()


def test_the_failed_step_of_buildx_is_shown_in_full() -> None:
    """All its lines, also those before another step's, none of others, and the end once."""
    assert failure(BUILDX) == [
        "[app 2/3] RUN make",
        "cc -c main.c",
        "main.c:1:1: error: unknown type name 'x'",
        "cc -c other.c",
        "#define is no step",
        "make: *** [Makefile:2: all] Error 1",
        'ERROR: process "/bin/sh -c make" did not complete successfully: exit code: 2',
        *BUILDX[-6:],
    ]


def test_a_failure_of_buildx_outside_the_dockerfile_is_shown() -> None:
    """A base image that is not there, a push that is refused: buildx counts them as steps."""
    lines = [
        "#2 [internal] load metadata for docker.io/library/none:1",
        "#2 ERROR: docker.io/library/none:1: not found",
        "------",
        " > [internal] load metadata for docker.io/library/none:1:",
        "------",
        "ERROR: failed to solve: docker.io/library/none:1: not found",
    ]
    assert failure(lines) == [lines[0].removeprefix("#2 "), lines[1].removeprefix("#2 "), lines[-1]]


def test_the_failed_step_of_podman_is_shown_in_full() -> None:
    """That of the platform which failed, though another platform's steps follow."""
    assert failure(PODMAN) == [*PODMAN[5:10], PODMAN[-1]]


def test_every_platform_that_failed_is_shown() -> None:
    """podman lists their errors at its end."""
    lines = [line for line in PODMAN if line != "--> a961ea8e8c0"][:-1]
    error = '\t* building at STEP "RUN echo "a" && make": exit status 2'
    end = ["Error: 2 errors occurred:", error, error]
    assert failure([*lines, *end]) == [*lines[1:3], *lines[4:9], *end]


def test_a_base_image_that_podman_cannot_pull_is_shown() -> None:
    """podman quotes no instruction then: it is the last one."""
    lines = ["STEP 1/2: FROM none:1", "Trying to pull none:1...", "Error: creating build container"]
    assert failure(["STEP 1/1: FROM scratch", "--> a961ea8e8c0", *lines]) == lines


def test_a_failure_before_the_first_step_has_none() -> None:
    """Then the last lines are all there is to show."""
    assert failure(["Error: no such Dockerfile"]) == []
    assert failure([]) == []


def test_a_long_step_is_shown_from_its_end() -> None:
    """Its instruction and its last lines, with how many are left out."""
    numbers = [str(n) for n in range(MOST_LINES + 50)]
    end = "Error: it ran out of paper"
    rest = numbers[51:]
    left_out = "[51 lines are left out here]"
    heading = "STEP 1/1: RUN count"
    assert failure([heading, *numbers, end]) == [heading, left_out, *rest, end]
    steps = ["#5 [1/1] RUN count", *(f"#5 0.1 {n}" for n in numbers), "#5 ERROR: exit code: 2"]
    assert failure(steps) == [
        "[1/1] RUN count",
        "[52 lines are left out here]",
        *rest[1:],
        "ERROR: exit code: 2",
    ]
