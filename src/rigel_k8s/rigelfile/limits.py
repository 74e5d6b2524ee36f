"""How large a Rigelfile may be, as written and as expanded; far above what a robot needs.

A file of a few lines can need more than a machine has: aliases of aliases, templates of
templates, the combinations of a matrix. Each limit is an error with its place.
"""

from __future__ import annotations

#: Bytes of a Rigelfile.
MOST_BYTES = 4 * 2**20
#: Values of a file with those from its aliases; and values from its templates.
MOST_VALUES = 20_000
#: Levels of nested lists and mappings.
DEEPEST = 100
#: Length of a chain of variables that need each other.
LONGEST_CHAIN = 50
#: Characters of one value from a template, and of all of them.
LONGEST_TEXT = 2**18
MOST_TEXT = 2**22
#: Characters of a number: more than YAML parsers agree on.
LONGEST_NUMBER = 400
#: Characters of an expression.
LONGEST_EXPRESSION = 1000
#: Seconds of the processor that all expressions of a file may take.
EXPRESSION_SECONDS = 2.0
#: Bytes of memory that one expression may take.
MOST_MEMORY = 2**28
#: Bits of a whole number: 1,234 digits.
MOST_BITS = 4096
#: Combinations of one matrix.
MOST_COMBINATIONS = 1000
#: Values that a check may process: those of each job, for each use and each combination.
MOST_LOOKED_AT = 100_000
#: Problems that are reported.
MOST_PROBLEMS = 300
#: Problems after which no similar name is searched for: the search takes longer than all the rest.
MOST_SUGGESTIONS = 50
#: Characters shown of a line, if the terminal's width is unknown, and of a message.
LONGEST_LINE = 160
LONGEST_MESSAGE = 1000
