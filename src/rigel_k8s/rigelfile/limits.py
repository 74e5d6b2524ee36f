"""How large a Rigelfile may be, and what it may make of itself; far above what a robot needs.

A file of a few lines can ask for more than a machine has: aliases of aliases, templates of
templates, the combinations of a matrix. Each limit is an error with its place.
"""

from __future__ import annotations

#: Bytes of a Rigelfile.
MOST_BYTES = 4 * 2**20
#: Values of a file with those that its aliases make; and values that its templates make.
MOST_VALUES = 20_000
#: Lists and mappings in each other.
DEEPEST = 100
#: Variables that need each other.
LONGEST_CHAIN = 50
#: Characters of one value that a template makes, and of all of them.
LONGEST_TEXT = 2**18
MOST_TEXT = 2**22
#: Characters of a number: more than YAML's readers agree on.
LONGEST_NUMBER = 400
#: Characters of an expression.
LONGEST_EXPRESSION = 1000
#: What all expressions of a file may read and make, in characters and entries of lists.
MOST_WORK = 2_000_000
#: What all their regular expressions may take.
REGEX_SECONDS = 0.25
#: Combinations of one matrix.
MOST_COMBINATIONS = 1000
#: Values that a check looks at: those of each job, for each use and each combination.
MOST_LOOKED_AT = 100_000
#: Problems that are reported.
MOST_PROBLEMS = 300
#: Characters of a line, where no terminal says how many it has, and of a message, that are shown.
LONGEST_LINE = 160
LONGEST_MESSAGE = 1000
