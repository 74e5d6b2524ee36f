"""Replaces `$(find PACKAGE)`, `$(env NAME)` and `$(optenv NAME DEFAULT)`. Python 2.7 and 3.

Why: roslaunch and ros2 launch replace such expressions when a program starts, because only its
image and its environment have the values. Other expressions, `$(date)`, stay as they are.
"""

import os
import subprocess

FIND = ("find", "find-pkg-share")
PACKAGES = os.path.join("share", "ament_index", "resource_index", "packages")


class Failure(Exception):
    """The container cannot start; the message is the cause, in one line."""


def substitute(text, find):
    """Return a text with its expressions replaced; `find` returns the directory of a package."""
    done, rest = "", text
    while True:
        before, opening, rest = rest.partition("$(")
        inside, closing, after = rest.partition(")")
        if not closing:
            return done + before + opening + rest
        value = evaluate(inside.split(), find)
        if value is None:  # its inside may have another one
            done += before + opening
        else:
            done, rest = done + before + value, after


def evaluate(words, find):
    """Return the value of an expression, None if it is not replaced."""
    if len(words) == 2 and words[0] in FIND:
        return find(words[1])
    if len(words) < 2 or words[0] not in ("env", "optenv"):
        return None
    value = os.environ.get(words[1])
    if value is None and words[0] == "env" and len(words) == 2:
        raise Failure("the environment variable %s of $(env %s) is not set" % (words[1], words[1]))
    return " ".join(words[2:]) if value is None else value


def substitute_all(value, find, one_type):
    """Return plain data with its texts replaced; a text that becomes a number or boolean is one.

    With one_type, as in ROS 2, this holds for a list as a whole: its values have one type.
    """
    if isinstance(value, dict):
        return {key: substitute_all(inner, find, one_type) for key, inner in value.items()}
    if isinstance(value, list):
        found = [substitute_all(inner, find, one_type) for inner in value]
        return found if found == value or not one_type else level(found, value, find)
    if not hasattr(value, "partition"):  # neither str nor Python 2's unicode
        return value
    text = substitute(value, find)
    return text if text == value else give_type(text)


def level(found, written, find):
    """Return the values of a list with one type: numbers, or what is written as texts as texts."""
    kinds = set(map(name_kind, found))
    if kinds == {"number"} and any(isinstance(value, float) for value in found):
        return [float(value) for value in found]
    if len(kinds) > 1 and set(map(name_kind, written)) == {"text"}:
        return [substitute(text, find) for text in written]
    if len(kinds) > 1:
        line = ", ".join(map(str, found))
        raise Failure("the values of the list [%s] must have one type in ROS 2" % line)
    return found


def name_kind(value):
    """Return the kind of a value: all numbers are of one, and so are all texts."""
    if isinstance(value, bool):
        return "truth"
    if isinstance(value, (dict, list)):
        return "tree"
    return "text" if hasattr(value, "partition") else "number"


def give_type(text):
    """Return what roslaunch reads a text as: "2" is 2, "1e3" 1000.0 and "True" is true."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    if text.strip("0123456789+-.eE"):  # Python reads more as a number, such as "nan" and "1_0"
        return text
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text


def find_ros1_package(name):
    """Return the directory of a package, as roslaunch finds it."""
    try:
        search = subprocess.Popen(
            ["rospack", "find", name], stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
    except OSError:
        raise Failure("$(find %s): there is no rospack in PATH; is ROS set up?" % name)
    path = search.communicate()[0].decode("utf-8").strip()
    if search.returncode != 0 or not path:
        raise missing(name, "ROS_PACKAGE_PATH")
    return str(path)


def find_ros2_package(name):
    """Return the share directory of a package, as ros2 launch finds it."""
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix and os.path.exists(os.path.join(prefix, PACKAGES, name)):
            return os.path.join(prefix, "share", name)
    raise missing(name, "AMENT_PREFIX_PATH")


def missing(name, variable):
    """Return the error for a missing package, with the place where it was looked for."""
    place = "%s=%s" % (variable, os.environ.get(variable, ""))
    return Failure("$(find %s): this image has no package %s (%s)" % (name, name, place))
