"""The messages in docs/muto-agent.md do what the page says."""

from __future__ import annotations

import json
import re
from pathlib import Path

from rigel_muto.agent.commands import Deploy
from rigel_muto.agent.protocols.ditto import Ditto
from rigel_muto.agent.protocols.ros1 import Ros1

from .recording import Remembering, give

PAGE = Path(__file__).parents[4] / "docs/muto-agent.md"
THING = "org.example.robots:r7"
COMMAND = Deploy(stack_id="org.example.robots:talker-listener")


def test_each_example_gets_the_answer_beside_it() -> None:
    blocks = re.findall(r"^```json\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    ros1, ros1_answer, message, answer, error = map(json.loads, blocks)
    executor, ditto = Remembering(), Ditto(THING)
    start = f"{THING}/stack/commands/start"
    assert give(Ros1(THING), executor, start, ros1, response_topic="answers") == [
        ("answers", ros1_answer)
    ]
    assert executor.commands == [COMMAND]
    assert give(ditto, executor, ditto.topic, message) == [("answers", answer)]
    assert [command.stack_id for command in executor.commands] == [COMMAND.stack_id] * 2  # type: ignore[union-attr]
    dance = json.loads(json.dumps(message).replace("commands/start", "commands/dance"))
    assert give(ditto, executor, ditto.topic, dance) == [("answers", error)]
