"""usage: python -m tools.recording --context NAME    write docs/recording.svg"""

from __future__ import annotations

import argparse
import re
import tempfile
from pathlib import Path

from tools.recording.commands import Run, run
from tools.recording.drawing import draw

ROOT = Path(__file__).parents[2]
PICTURE = ROOT / "docs" / "recording.svg"
TUTORIAL = ROOT / "docs" / "tutorials" / "ros1.md"
#: The tutorial's.
NAMESPACE = "tutorial"


def main() -> None:
    """Run the first tutorial's commands, and draw them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--context", required=True, help="a cluster of two machines")
    parser.add_argument("--namespace", default=NAMESPACE, help="where it runs")
    arguments = parser.parse_args()
    found = re.search(r'```yaml title="Rigelfile"\n(.*?)```', TUTORIAL.read_text("utf-8"), re.S)
    assert found, f"{TUTORIAL} shows no Rigelfile"
    text = found[1].replace(f"namespace: {NAMESPACE}", f"namespace: {arguments.namespace}")
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        file = place / "Rigelfile"
        file.write_text(text.replace("apart_from", "apart_form"))
        runs = [run("rigel check", place, context=arguments.context, code=2)]
        file.write_text(text)
        runs.append(run("rigel run job deploy", place, context=arguments.context, live=False))
        runs.append(run("rigel status", place, context=arguments.context))
        runs.append(run("rigel graph", place, context=arguments.context))
        run("rigel down --yes", place, context=arguments.context)
    runs = [Run(one.command, one.output.replace(arguments.namespace, NAMESPACE)) for one in runs]
    PICTURE.write_text(draw("rigel checks, deploys and shows a ROS application", runs), "utf-8")


if __name__ == "__main__":
    main()
