"""What commands may use."""

from __future__ import annotations

import pytest

from rigel_k8s.errors import UserError
from rigel_muto.agent.allowance import Allowance


def test_every_image_of_a_stack_must_be_allowed() -> None:
    """Not only the first: a stack's nodes may have images of their own in the job."""
    allowance = Allowance(images=("lab/*",))
    allowance.check_images(["lab/a:1", "lab/b:1"])
    with pytest.raises(UserError, match='the image "other/b:1" is not allowed: images: lab/'):
        allowance.check_images(["lab/a:1", "other/b:1"])
