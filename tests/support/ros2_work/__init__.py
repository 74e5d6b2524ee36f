"""Nodes that do all that a hand-over keeps apart, who calls them, and what their lines mean.

The programs run in an image with rclpy; worker.py and caller.py need test_msgs. image.py makes an
image with it, in which all of them are the package `rigel_work`.
"""

from pathlib import Path

HERE = Path(__file__).parent
PACKAGE = "rigel_work"
#: For `python3 -c`, where no image is made.
TALKER = (HERE / "talker.py").read_text()
