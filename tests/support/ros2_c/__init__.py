"""Programs in C on rcl, which stand for those of rclcpp: PyPI has rcl with its headers, not rclcpp.

main.c runs the component that it is linked to, or loads components as a container does.
"""

from __future__ import annotations

from pathlib import Path

from ..layer import compile_c

HERE = Path(__file__).parent
#: Program -> its sources.
SOURCES = {
    "container": ("main.c", "spin.c"),
    "part": ("main.c", "spin.c", "part.c"),
    "worker": ("main.c", "spin.c", "worker.c"),
    "caller": ("caller.c", "spin.c"),
    "topics": ("topics.c", "spin.c"),
    # Components, for a container.
    "part.so": ("part.c",),
    "worker.so": ("worker.c",),
}


def compile_ros(environment: Path, room: Path, distro: str, name: str) -> Path:
    """Compile a program with the ROS 2 of a virtual environment that has the wheels of `distro`."""
    includes = [f"-isystem{path}" for path in sorted((environment / "include").iterdir())]
    words = [*includes, *(HERE / source for source in SOURCES[name])]
    folders = sorted({str(path.parent) for path in environment.rglob("lib*.so*")})
    names = ["rcl", "rcutils", "rosidl_runtime_c"]
    for package in ("std_msgs", "rcl_interfaces"):
        names += [f"{package}__rosidl_{kind}_c" for kind in ("generator", "typesupport")]
    words += ["-Wl,--no-as-needed", f"-L{environment}/lib", *(f"-l{one}" for one in names)]
    # Searched for the libraries of libraries, too: the wheels' own paths are of other folders.
    words += ["-Wl,--disable-new-dtags", f"-Wl,-rpath,{':'.join(folders)}"]
    words.append("-Wl,--allow-shlib-undefined")
    kind = ("-shared", "-fPIC") if name.endswith(".so") else ("-rdynamic",)
    return compile_c(room / f"{distro}-{name}", *kind, *words)
