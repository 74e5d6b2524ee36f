"""Names, and what ROS itself does with them: rcl of jazzy, and rosgraph.names of noetic.

tests/ros2/test_names.py asks rcl again; the unit tests compare our forms with the answers.
"""

from __future__ import annotations

#: A name, and whether rcl takes it as the left and as the right side of `-r`.
RCL = [
    *((name, True, True) for name in ("input", "/input", "~/input", "a/b", "_x", "/_x", "~/_a")),
    *((name, True, True) for name in ("a/_action/feedback", "a_", "a_/b", "a_1", "A1", "/a/b_")),
    *((name, True, False) for name in ("rostopic://a", "rosservice:///a", "rostopic://~/a")),
    *((name, True, False) for name in ("other:topic", "other:~/topic", "other:rostopic://a")),
    *((name, False, False) for name in ("~input", "~", "/", "a//b", "a/", "/a/", "1x", "/a/1x")),
    *((name, False, False) for name in ("a__b", "a__", "__x", "a/__b", "a-b", "a b", "~/", "~//a")),
    *((name, False, False) for name in ("*", "/a/*", "**", "a{b}", "ä", "a.b", "x:y:z", "1o:t")),
]
#: The same for `-r __node:=`, `-r __ns:=`; ROS has at most 245 characters, less for services.
NODES = [
    *((name, True) for name in ("n", "_n", "n_", "a1", "A_b", "a" * 200)),
    *((name, False) for name in ("1n", "a__b", "a-b", "~n", "a.b", "ä", "a" * 246)),
]
#: A name, and whether rosgraph.names.is_legal_name has it.
ROSGRAPH = [
    *((name, True) for name in ("input", "/input", "~input", "~/input", "a/b", "a/", "/1x", "/_x")),
    *((name, True) for name in ("a__b", "/a/1x", "~1x", "~_x")),
    *((name, False) for name in ("a//b", "1x", "_x", "a-b", "/r/~x", "other:topic", "a b", "ä")),
]
