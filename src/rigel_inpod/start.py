"""start.py ros1|ros2 [OPTION]... -- PROGRAM [ARGUMENT]...: prepares a container for PROGRAM.

Why: some arguments and parameters are known only inside the image: the place of a package, the
content of one of its files, the output of one of its programs.
Contract: README.md beside it. Python 2.7 and 3. The options, in any order:

  --substitute           replace $(find P), $(env X) and $(optenv X D) in all that follows
  --env NAME             and in this variable
  --complete FILE        and in this JSON file; PROGRAM gets the path of a copy instead of FILE
  --load FILE NAMESPACE  ROS 1: the parameters of a YAML file
  --values FILE NAMESPACE  the parameters of a JSON file; ROS 2: NAMESPACE is a pattern of nodes
  --run NAME COMMAND     a parameter whose value COMMAND prints; ROS 2: for any node
  --keep NAME            instead of a program: see globalparameters.py

Later parameters win. In ROS 1 they are set at the master; in ROS 2 they are written into a file
that PROGRAM receives. A failure is reported in one line, and ends the container.
"""

import json
import os
import shlex
import subprocess
import sys
import tempfile

import globalparameters
import rosparameters
from substitution import Failure, find_ros1_package, find_ros2_package, substitute, substitute_all

#: How many words follow an option.
OPTIONS = {
    "--substitute": 0,
    "--env": 1,
    "--complete": 1,
    "--load": 2,
    "--values": 2,
    "--run": 2,
    "--keep": 1,
}
ANY_NODE = "/**"
TERMINATION = "/dev/termination-log"
#: Where a container can write, even if its file system is read-only and has no volume at /tmp.
SHARED_MEMORY = "/dev/shm"


class Start(object):
    """What a container's command line requests."""

    def __init__(self, words):
        self.ros2 = words[0] == "ros2"
        self.options = []
        rest = words[1:]
        while rest and rest[0] != "--":
            count = OPTIONS[rest[0]]
            self.options.append((rest[0], rest[1 : count + 1]))
            rest = rest[count + 1 :]
        self.program = rest[1:]
        self._substitutes = bool(self.values("--substitute"))

    def values(self, option):
        """Return the words after each use of an option."""
        return [words for name, words in self.options if name == option]

    def complete(self, text):
        """Return a text as the program receives it."""
        return substitute(text, self._find) if self._substitutes else text

    def prepare_environment(self):
        """Complete the variables whose values contain expressions."""
        for (name,) in self.values("--env"):
            os.environ[name] = self.complete(os.environ.get(name, ""))

    def complete_program(self):
        """Return PROGRAM and its arguments, with the copies of completed files."""
        copies = {}
        for (path,) in self.values("--complete"):
            with open(path) as file:
                copies[path] = write_json(self._substitute(json.load(file)))
        return [copies.get(word) or self.complete(word) for word in self.program]

    def read_parameters(self):
        """Return [(namespace, tree of parameters)], in the order of the options."""
        read = {"--load": self._load, "--values": self._values, "--run": self._run}
        found = []
        for option, words in self.options:
            if option in read:
                found.extend(read[option](*words))
        return found

    def _find(self, package):
        return find_ros2_package(package) if self.ros2 else find_ros1_package(package)

    def _load(self, path, namespace):
        return rosparameters.load(self.complete(path), namespace)

    def _values(self, path, namespace):
        with open(path) as file:
            tree = json.load(file)
        return [(namespace, self._substitute(tree) if self._substitutes else tree)]

    def _substitute(self, tree):
        return substitute_all(tree, self._find, one_type=self.ros2)

    def _run(self, name, command):
        words = [self.complete(word) for word in shlex.split(command)]
        namespace, _, last = name.rpartition("/")
        return [(ANY_NODE if self.ros2 else namespace or "/", {last: run(words, last)})]


def run(words, name):
    """Return the output of a command."""
    what = "the command of the parameter %s, `%s`," % (name, " ".join(words))
    try:
        child = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    except OSError as error:
        raise Failure("%s cannot be run: %s" % (what, error.strerror))
    output, errors = (part.decode("utf-8", "replace") for part in child.communicate())
    if child.returncode != 0:
        said = errors.strip() or output.strip() or "it printed no error"
        last = said.split("\n")[-1]
        raise Failure("%s failed with exit code %d: %s" % (what, child.returncode, last))
    sys.stderr.write(errors)
    return output


def write_file(trees):
    """Return the path of a new parameter file of ROS 2."""
    nodes = {}
    for pattern, tree in trees:
        nodes.setdefault(pattern, {"ros__parameters": {}})["ros__parameters"].update(tree)
    return write_json(nodes, suffix=".yaml")


def write_json(value, suffix=".json"):
    """Return the path of a new file with plain data, where this container can write."""
    text = json.dumps(value)
    for directory in (None, SHARED_MEMORY):
        try:
            return write_text(text, suffix, directory)
        except EnvironmentError as error:
            cause = error.strerror or str(error)
    raise Failure(
        "no file can be written in $TMPDIR, /tmp or %s: %s; mount a volume at /tmp"
        % (SHARED_MEMORY, cause)
    )


def write_text(text, suffix, directory):
    """Return the path of a new file, in the first directory for such files if none is named."""
    descriptor, path = tempfile.mkstemp(suffix, "rigel-k8s-", directory)
    try:
        with os.fdopen(descriptor, "w") as file:
            file.write(text)
    except EnvironmentError:
        os.remove(path)
        raise
    return path


def main(words):
    """Prepare the container, and become its program."""
    start = Start(words)
    start.prepare_environment()
    program = start.complete_program()
    trees = start.read_parameters()
    for (name,) in start.values("--keep"):
        globalparameters.keep(name, trees)
    if trees and start.ros2:
        program += ["--ros-args", "--params-file", write_file(trees)]
    elif trees:
        rosparameters.set_all(trees)
    sys.stdout.flush()
    try:
        os.execvp(program[0], program)
    except OSError as error:
        raise Failure("%s cannot be run: %s" % (program[0], error.strerror))


def report(line):
    """Write a line into the container's status, if Kubernetes has a file for it."""
    if os.path.exists(TERMINATION):
        with open(TERMINATION, "w") as file:
            file.write(line)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except Failure as failure:
        report(str(failure))
        sys.exit("rigel: %s" % failure)
