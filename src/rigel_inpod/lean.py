"""Runs keeper.py in less memory: `lean.py PATH ARGUMENT...`, where PATH is that of keeper.py.

Why: a compiler leaves two megabytes behind in its process, and each pod of ROS 2 has a keeper. So a
child compiles, and this process gets what came out. It could also come from .pyc files, but where
the pod may write them, each of its programs could replace them.
Contract: Python 3.6. stop.sh knows the keeper by PATH.
"""

import marshal
import os
import sys

#: What it consists of, each after those that it imports.
SCRIPTS = ("container", "progress", "rmw_notes", "rates", "handover", "keeper")


def compile_in_child(folder):
    """Return the code of the scripts."""
    mine, theirs = os.pipe()
    child = os.fork()
    if not child:
        with os.fdopen(theirs, "wb") as pipe:
            for name in SCRIPTS:
                path = os.path.join(folder, name + ".py")
                with open(path, "rb") as script:
                    marshal.dump(compile(script.read(), path, "exec"), pipe)
        os._exit(0)
    os.close(theirs)
    with os.fdopen(mine, "rb") as pipe:
        found = [marshal.load(pipe) for _ in SCRIPTS]
    os.waitpid(child, 0)
    return found


def main(script, *arguments):
    """Run the keeper; return its exit code."""
    for name, code in zip(SCRIPTS, compile_in_child(os.path.dirname(script))):
        module = sys.modules[name] = type(sys)(name)
        exec(code, module.__dict__)
    return sys.modules["keeper"].main(list(arguments), os.environ)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
