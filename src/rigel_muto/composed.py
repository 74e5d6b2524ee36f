"""Several nodes of a stack in one process: composable nodes and nodelets as `components`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import attrs

from rigel_k8s.problems import Path
from rigel_k8s.rigelfile.source import YamlNode, kind_of, node_of, strip_places
from rigel_k8s.substitution_args import has_substitution, split_line
from rigel_muto.arguments import Arguments
from rigel_muto.nodes import Translated, translate_node
from rigel_muto.remarks import Remark, error, loss, note
from rigel_muto.stack import is_empty, text_at

COMPONENTS = "components"
#: Options that a component has, too.
OPTIONS = ("package", "plugin", "parameters", "remappings")
#: Options with parameters that a component does not have.
FILES, COMMANDS = "parameter_files", "parameter_commands"
#: Options of the loading node: its components' values are completed where its own options are.
SUBSTITUTION = "substitution_args"
#: The program that loads nodelets, and the program that it runs.
NODELET = ("nodelet", "nodelet")


@attrs.frozen
class Loader:
    """A node that does nothing but load a nodelet.

    Attributes:
        manager: the key of the node that it loads it into.
    """

    plugin: str
    manager: str


def translate_container(entry: YamlNode, arguments: Arguments) -> Translated:
    """Return a container of composable nodes as an entry of `nodes`."""
    content = {key: value for key, value in entry.value.items() if key != "node"}
    for key, own in (("pkg", "package"), ("exec", "executable")):
        if own not in content or is_empty(content[own]):
            missing = error(entry, f'the key "{own}" is missing', "missing-key")
            return Translated(text_at(content, "name"), None, (missing,))
        content[key] = content.pop(own)
    made = translate_node(attrs.evolve(entry, value=content), arguments)
    if made.options is None:
        return made
    components: dict[str, YamlNode] = {}
    remarks = list(made.remarks)
    for one in list_composables(entry, remarks):
        component = translate_composable(one, arguments, (made.key, COMPONENTS))
        remarks += component.remarks
        if component.options is not None:
            if component.key in components:
                message = f'the component "{component.key}" already exists: this one replaces it'
                remarks.append(note(one, message, "duplicate-node"))
            components[component.key] = component.options
    options = add_components(made.options, components)
    return Translated(made.key, options, tuple(remarks))


def list_composables(entry: YamlNode, remarks: list[Remark]) -> Iterator[YamlNode]:
    """Yield the mappings in a container's `node`; remark on other values."""
    section = entry.value.get("node")
    if section is None or is_empty(section):
        return
    for one in section.value if isinstance(section.value, list) else [section]:
        if isinstance(one.value, dict):
            yield one
        else:
            message = f'an entry of "node" must be a mapping, got {kind_of(one.value)}'
            remarks.append(error(one, message, "wrong-type"))


def translate_composable(entry: YamlNode, arguments: Arguments, above: Path) -> Translated:
    """Return a composable node as an entry of `components`; `above` is their path in `nodes`."""
    plugin = entry.value.get("plugin")
    if plugin is None or is_empty(plugin):
        missing = error(entry, 'the key "plugin" is missing', "missing-key")
        return Translated(text_at(entry.value, "name"), None, (missing,))
    content = {key: value for key, value in entry.value.items() if key != "plugin"}
    node = attrs.evolve(entry, value={**content, "exec": plugin})
    made = translate_node(node, arguments, above)
    if made.options is None:
        return made
    options = dict(made.options.value)
    options["plugin"] = options.pop("executable")
    return keep_options(made, options, above)


def keep_options(made: Translated, options: Mapping[str, YamlNode], above: Path) -> Translated:
    """Return a component with those of a node's options that it can have."""
    assert made.options is not None, "asked before"
    found = {key: options[key] for key in OPTIONS if key in options}
    if any(has_substitution(strip_places(value)) for value in found.values()):
        found[SUBSTITUTION] = node_of(True, made.options)
    lost = [
        loss(
            value,
            f"`{key}` of a component is not carried over: it runs in the process of {above[0]}",
            node=str(above[0]),
        )
        for key, value in options.items()
        if key not in (*OPTIONS, FILES, COMMANDS, SUBSTITUTION)
    ]
    kept = attrs.evolve(made.options, value=found)
    lost += list_lost_parameters(made.key, options, above)
    return Translated(made.key, kept, (*made.remarks, *lost))


def list_lost_parameters(
    key: str, options: Mapping[str, YamlNode], above: Path
) -> Iterator[Remark]:
    """Yield remarks on parameters that a component's node reads from files or programs."""
    node, *below = (*above, key, "parameters")
    files = options[FILES].value if FILES in options else []
    commands = options[COMMANDS].value if COMMANDS in options else {}
    lost = [("file", one, tuple(below)) for one in files]
    lost += [("program", one, (*below, name)) for name, one in commands.items()]
    for what, one, option in lost:
        message = (
            f"parameters from a {what} of the image cannot be carried over to a component:"
            f" set nodes.{'.'.join(map(str, (node, *option)))} in the Rigelfile"
        )
        yield loss(one, message, kind="needs-container", node=str(node), option=option)


def add_components(node: YamlNode, components: Mapping[str, YamlNode]) -> YamlNode:
    """Return a node's options with components beside those that it has, and what they need."""
    if not components:
        return node
    there = node.value.get(COMPONENTS, attrs.evolve(node, value={}))
    options = dict(node.value)
    own = {}
    for key, component in components.items():
        own[key] = leave_out(component, SUBSTITUTION)
        if SUBSTITUTION in component.value:
            options[SUBSTITUTION] = component.value[SUBSTITUTION]
    options[COMPONENTS] = attrs.evolve(there, value={**there.value, **own})
    return attrs.evolve(node, value=options)


def find_loader(key: str, options: YamlNode) -> Loader | None:
    """Return what a node loads, None for any other node."""
    words = list_words(options)
    if words[:1] != ["load"] or len(words) < 3:
        return None
    manager = words[2]
    namespace = key.rpartition("/")[0]
    if not manager.startswith("/") and namespace:
        manager = f"{namespace}/{manager}"
    return Loader(words[1], manager.strip("/"))


def list_words(options: YamlNode) -> list[str]:
    """Return the arguments of `nodelet`, nothing for another program."""
    program = tuple(text_at(options.value, key) for key in ("package", "executable"))
    if program != NODELET:
        return []
    try:
        return split_line(text_at(options.value, "args"))
    except ValueError:  # the check of the job reports it
        return []


def translate_nodelet(entry: YamlNode, arguments: Arguments, loader: Loader) -> Translated:
    """Return a node that loads a nodelet as an entry of its manager's `components`."""
    above: Path = (loader.manager, COMPONENTS)
    made = translate_node(entry, arguments, above)
    if made.options is None:
        return made
    plugin = node_of(loader.plugin, made.options.value["args"])
    options = leave_out_program(made.options).value
    return keep_options(made, {"plugin": plugin, **options}, above)


def simplify_manager(manager: YamlNode) -> YamlNode:
    """Return a manager without the program that a node with components has anyway."""
    return leave_out_program(manager) if list_words(manager) == ["manager"] else manager


def leave_out_program(node: YamlNode) -> YamlNode:
    """Return a node's options without what it runs."""
    return leave_out(node, "package", "executable", "args")


def leave_out(node: YamlNode, *keys: str) -> YamlNode:
    """Return a node's options without some."""
    return attrs.evolve(node, value={k: v for k, v in node.value.items() if k not in keys})
