"""What is in the graph: topics, nodes, services."""

from failure import Failure
from session import appears, full, hidden, session, spin, topic_type


def topics(options):
    with session(options) as node:
        found = node.get_topic_names_and_types()
    shown = [(n, t) for n, t in found if options.include_hidden_topics or not hidden(n)]
    if options.count_topics:
        print(len(shown))
        return
    _show(shown, options.show_types)


def services(options):
    with session(options) as node:
        found = node.get_service_names_and_types()
    shown = [(n, t) for n, t in found if options.include_hidden_services or not hidden(n)]
    _show(shown, options.show_types)


def topic_type_of(options):
    with session(options, wait=False) as node:
        print(topic_type(node, options.topic, options))


def topic_info(options):
    topic = full(options.topic)
    with session(options, wait=False) as node:
        kind = topic_type(node, topic, options)
        spin(node, lambda: False, options.spin_time)
        publishers = node.get_publishers_info_by_topic(topic)
        subscribers = node.get_subscriptions_info_by_topic(topic)
    print(f"Type: {kind}")
    for what, ends in (("Publisher", publishers), ("Subscription", subscribers)):
        print(f"{what} count: {len(ends)}")
        for end in ends if options.verbose else ():
            print(f"\n{end}\n")


def nodes(options):
    with session(options) as node:
        found = sorted(_nodes(node))
    shown = [name for name in found if options.all or not hidden(name)]
    print("\n".join(shown) if not options.count_nodes else len(shown))


def node_info(options):
    wanted = full(options.node)
    with session(options, wait=False) as node:
        if not appears(node, lambda: wanted in _nodes(node), options):
            raise Failure(f"Unable to find node '{wanted}'")
        spin(node, lambda: False, options.spin_time)
        space, _, name = wanted.rpartition("/")
        print(wanted)
        for title, ask in (
            ("Subscribers", node.get_subscriber_names_and_types_by_node),
            ("Publishers", node.get_publisher_names_and_types_by_node),
            ("Service Servers", node.get_service_names_and_types_by_node),
            ("Service Clients", node.get_client_names_and_types_by_node),
        ):
            print(f"  {title}:")
            for found, types in sorted(ask(name, space or "/")):
                print(f"    {found}: {', '.join(types)}")


def _nodes(node):
    return {f"{space.rstrip('/')}/{name}" for name, space in node.get_node_names_and_namespaces()}


def _show(found, types):
    for name, kinds in sorted(found):
        print(f"{name} [{', '.join(kinds)}]" if types else name)
