"""How log lines become entries: what goes on a line before, and at which level it is.

Both collectors do the same by these expressions (Go's, without look-ahead), and `rigel logs` does
it where there is no Loki (commands/logs/levels.py).
"""

from __future__ import annotations

#: Put before a line that goes on although it is not indented, and taken away when it is joined: no
#: expression of Go's can say "any line but these".
MARK = r"\x01"
#: The same, put there by a template.
MARKED = '{{ "\\x01" }}{{ .Value }}'
#: The end of a Python traceback: an exception's name and what it says; and what stands between two.
GOES_ON = (
    r"^((?:[A-Za-z_]\w*\.)*[A-Z]\w*(?:Error|Exception|Interrupt|Exit|Iteration|Warning|Timeout)"
    r"(?:: .*)?$"
    r"|During handling of the above exception, another exception occurred:$"
    r"|The above exception was the direct cause of the following exception:$)"
)
#: What begins an entry: anything that is neither marked nor indented nor empty.
FIRST_LINE = rf"^[^\s{MARK}]"
#: How long a line waits for what may go on with it.
WAIT = "1s"
#: Lines of one entry at most.
LONGEST = 1000

COLOURS = r"(?:\x1b\[[0-9;]*m)*"
#: What roslaunch and ros2 launch put before a process' lines: [talker-1].
PROCESS = r"(?:\[[^\]\s]+-\d+\] *)?"
START = rf"(?i)^{COLOURS}\s*{PROCESS}{COLOURS}"
WORDS = "trace|debug|info|warn|warning|error|critical|fatal"
#: Each finds a level, or nothing; no line has two of these forms.
LEVEL_FORMS = (
    # ROS 1 ([INFO] [1700000000.1]: ..., [ INFO]), ROS 2, and what launches them.
    rf"{START}\[ *(?P<level>{WORDS}) *\]",
    # rosmaster and other loggers of Python: [rosmaster.main][INFO] ..., ERROR:root: ...
    rf"{START}\[[\w./]+\]\[(?P<level>{WORDS})\]",
    rf"{START}(?P<level>{WORDS}):",
    # zenoh's router, and others of Rust.
    rf"{START}\d{{4}}-\d\d-\d\d[T ][\d:.,]+(?:Z|[+-]\d\d:?\d\d)? +(?P<level>{WORDS})\b",
    # Fast DDS.
    rf"{START}(?:\d{{4}}-\d\d-\d\d [\d:.]+ )?\[\w+ (?P<level>info|warning|error)\]",
    # The stack's own parts.
    rf"{START}(?:(?:ts|time)=\S+ .*?)?\blevel=(?P<level>{WORDS})\b",
)
#: A traceback that nobody logged.
TRACEBACK = r"^(?P<traceback>Traceback) \(most recent call last\):"
#: From the word that was found to one of names.LEVELS.
LEVEL_TEMPLATE = (
    '{{ $word := ToLower (or .level "") }}'
    '{{ if eq $word "warning" }}warn'
    '{{ else if eq $word "critical" }}fatal'
    '{{ else if eq $word "trace" }}debug'
    "{{ else if $word }}{{ $word }}"
    "{{ else if .traceback }}error{{ end }}"
)
