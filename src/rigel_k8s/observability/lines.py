"""The forms of log lines: which continue an entry, and which word is its level.

Collectors and `rigel logs` read the same expressions, those of Go and Python alike.
"""

from __future__ import annotations

#: Put before a line that continues an entry although it is not indented, and removed when it is
#: joined: an expression of Go cannot match "any line except these".
MARK = r"\x01"
#: The same, put there by a template.
MARKED = '{{ "\\x01" }}{{ .Value }}'
#: The end of a Python traceback: an exception's name and message, and the text between two of them.
GOES_ON = (
    r"^((?:[A-Za-z_]\w*\.)*[A-Z]\w*(?:Error|Exception|Interrupt|Exit|Iteration|Warning|Timeout)"
    r"(?:: .*)?$"
    r"|During handling of the above exception, another exception occurred:$"
    r"|The above exception was the direct cause of the following exception:$)"
)
#: The beginning of an entry: a line that is neither marked nor indented nor empty.
FIRST_LINE = rf"^[^\s{MARK}]"
#: How long a line waits for lines that continue it.
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
#: A traceback that was printed without logging.
TRACEBACK = r"^(?P<traceback>Traceback) \(most recent call last\):"
#: From the word that was found to one of names.LEVELS.
LEVEL_WORDS = {"warning": "warn", "critical": "fatal", "trace": "debug"}
#: The same as a template of Promtail.
LEVEL_TEMPLATE = (
    '{{ $word := ToLower (or .level "") }}{{ if not $word }}{{ if .traceback }}error{{ end }}'
    + "".join(f'{{{{ else if eq $word "{word}" }}}}{level}' for word, level in LEVEL_WORDS.items())
    + "{{ else }}{{ $word }}{{ end }}"
)
