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
#: Arguments behind `--ros-args`, and whether rcl starts with them.
ARGUMENTS = [
    *((words, True) for words in (["-p", "a.b:=[1, 2]"], ["-p", "n:a:=1"], ["-p", "m:=a b"])),
    *((words, True) for words in (["-r", "n:~/a:=/b"], ["--remap", "rostopic://a:=~/b"])),
    *((words, True) for words in (["--log-level", "n:=debug"], ["-e", "/x", "--", "--own", "x"])),
    *((words, True) for words in (["--disable-rosout-logs"], ["--enable-external-lib-logs"])),
    (["--log-file-name", "x", "--disable-stdout-logs", "-r", "__node:=n", "--ros-args"], True),
    *((words, False) for words in (["-r", "~a:=/b"], ["-r", "a:=/b-c"], ["-r", "a"], ["a:=1"])),
    *((words, False) for words in (["-p", "a=1"], ["-p", "a:="], ["-p", ":=1"], ["-p", "a: 1"])),
    *((words, False) for words in (["--own", "x"], ["--params-file=/a"], ["-r __node:=n"])),
    *((words, False) for words in (["-p", "a:=1", "-r"], ["-p rate:=10"])),
]
#: A name, and whether rosgraph.names.is_legal_name has it.
ROSGRAPH = [
    *((name, True) for name in ("input", "/input", "~input", "~/input", "a/b", "a/", "/1x", "/_x")),
    *((name, True) for name in ("a__b", "/a/1x", "~1x", "~_x")),
    *((name, False) for name in ("a//b", "1x", "_x", "a-b", "/r/~x", "other:topic", "a b", "ä")),
]
