"""A stack that is an archive with sources: its files, and the one node that launches them.

Muto builds such a stack on the device when it starts it. Here an image is built from it, so that
the same programs run on each machine and after each restart.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping

import attrs

from rigel_k8s.rigelfile.source import YamlNode, node_of
from rigel_k8s.system.trees import File, Tree
from rigel_muto.reading import decode_base64
from rigel_muto.remarks import Remark, Unreadable, describe_unknown, error, loss
from rigel_muto.stack import Archive, Stack, is_empty, text_at
from rigel_muto.translation import Translation
from rigel_muto.unpacking import BadArchive, check_tree, enter, flatten, make_path, unpack

#: The keys of an archive that have a meaning here, and those that only Muto needs.
CARRIED = ("data", "launch_file", "launch_args", "flatten", "subdir", "checksum", "algorithm")
UNNEEDED = ("command", "filename", "url", "headers", "timeout")
ROS_ARGS = "`ros_args` is not carried over: set the node's `env` or `launch.args` instead"
FETCH = (
    "an archive is not fetched from a URL: download and unpack it, and write a Rigelfile with the"
    " jobs rigel_k8s.DockerfilePlugin and rigel_k8s.BuildXPlugin"
)
NO_FILE = "an archive needs a `launch_file`, which says what to start"


def find_archive(stack: Stack) -> Archive | None:
    """Return the sources that a stack consists of, alone or as the only part of a solution."""
    return find_archive(stack.parts[0]) if len(stack.parts) == 1 else stack.archive


def unpack_archive(archive: Archive) -> Tree:
    """Return the files of an archive, as Muto lays them out.

    Raises:
        Unreadable: they are not available, or are not what they should be.
    """
    data = archive.values.get("data")
    if data is None or is_empty(data):
        place = archive.values.get("url")
        message = "an archive needs `data`: a tar or zip in base64" if place is None else FETCH
        raise Unreadable(error(place or archive.place, message, "no-archive", key=True))
    content = decode_base64(data)
    _check_sum(archive, content)
    try:
        tree = _lay_out(unpack(content), archive.values)
        check_tree(tree)
    except BadArchive as fault:
        raise Unreadable(error(data, str(fault), "bad-archive", key=True)) from fault
    return tree


def _check_sum(archive: Archive, content: bytes) -> None:
    """Refuse content that does not have the checksum: its own, or that of its base64.

    Muto's composer expects the first, Muto's script that packs archives writes the second.
    """
    expected = archive.values.get("checksum")
    if expected is None or is_empty(expected):
        return
    algorithm = (text_at(archive.values, "algorithm") or "sha256").lower()
    if algorithm not in hashlib.algorithms_guaranteed or algorithm.startswith("shake"):
        message = f'unknown algorithm "{algorithm}" of the checksum: use sha256'
        raise Unreadable(error(archive.values["algorithm"], message, "bad-checksum"))
    base64 = "".join(str(archive.values["data"].value).split()).encode()
    sums = [hashlib.new(algorithm, text).hexdigest() for text in (content, base64)]
    if str(expected.value).lower() not in sums:
        message = f"the archive does not have this {algorithm} checksum, but {sums[0]}"
        raise Unreadable(error(expected, message, "bad-checksum"))


def _lay_out(tree: Tree, values: Mapping[str, YamlNode]) -> Tree:
    """Return the tree with `subdir` at its top, or without a top directory that has all of it."""
    if subdir := text_at(values, "subdir"):
        return enter(tree, subdir)
    wanted = values.get("flatten")
    return tree if wanted is not None and wanted.value is False else flatten(tree)


def translate_archive(
    archive: Archive, key: str, tree: Tree, directory: str, given: Mapping[str, str]
) -> Translation:
    """Return the node that launches what an archive has.

    Args:
        key: of the node.
        tree: the archive's files.
        directory: where the image has them.
        given: arguments of the launch file, which win over those of the archive.

    Raises:
        Unreadable: there is nothing to launch.
    """
    at = archive.place
    file = _find_launch_file(archive, tree)
    path = node_of(f"{directory}/{file}", at)
    arguments = {**_read_arguments(archive), **{k: node_of(v, at) for k, v in given.items()}}
    remarks = list(_remark_on_rest(archive))
    if file.endswith(".sh"):
        if arguments:
            message = "arguments are not carried over: a script is started without any"
            remarks.append(loss(archive.values.get("launch_args", at), message))
        words = attrs.evolve(at, value=[node_of("bash", at), path], raw=None)
        update = attrs.evolve(at, value={"strategy": node_of("Recreate", at)}, raw=None)
        options = {"anonymous": node_of(True, at), "args": words, "update": update}
    else:
        launch = {"file": path}
        if arguments:
            launch["args"] = attrs.evolve(at, value=arguments, raw=None)
        options = {"launch": attrs.evolve(at, value=launch, raw=None)}
    node = attrs.evolve(at, value=options, raw=None)
    return Translation({key: node}, tuple(remarks))


def _find_launch_file(archive: Archive, tree: Tree) -> str:
    """Return the path of the launch file: at the top, or the only one that ends so."""
    written = text_at(archive.values, "launch_file")
    if not written:
        raise Unreadable(error(archive.place, NO_FILE, "missing-key", key=True))
    place = archive.values["launch_file"]
    try:
        wanted = make_path(written)
    except BadArchive as fault:
        raise Unreadable(error(place, str(fault), "bad-archive")) from fault
    files = sorted(path for path, entry in tree.items() if isinstance(entry, File))
    if wanted in files:
        return wanted
    found = [path for path in files if path.endswith(f"/{wanted}")]
    if len(found) == 1:
        return found[0]
    also = f", but {' and '.join(found[:3])}: write one of them" if found else ""
    message = f'the archive has no file "{written}"{also}'
    raise Unreadable(error(place, message, "no-launch-file"))


def _read_arguments(archive: Archive) -> dict[str, YamlNode]:
    """Return the arguments of the launch file."""
    section = archive.values.get("launch_args")
    if section is None or is_empty(section):
        return {}
    found = {}
    for entry in section.value if isinstance(section.value, list) else [section]:
        content = entry.value if isinstance(entry.value, dict) else {}
        name = text_at(content, "name")
        value = content.get("value", content.get("default"))
        if not name or value is None or isinstance(value.value, dict | list | None):
            message = "an argument of a launch file needs `name` and `default`"
            raise Unreadable(error(entry, message, "missing-key"))
        found[name] = attrs.evolve(value, key_span=content["name"].span)
    return found


def _remark_on_rest(archive: Archive) -> Iterator[Remark]:
    """Yield the keys of an archive beside its sources and its launch file."""
    for name, value in archive.values.items():
        if is_empty(value) or name in (*CARRIED, *UNNEEDED):
            continue
        if name == "ros_args":
            yield loss(value, ROS_ARGS)
        else:
            yield loss(value, describe_unknown(name, "an archive", CARRIED))
