"""ROS messages and plain data, as YAML has it."""

import array
import importlib
import re

from failure import Failure


def message_class(kind):
    """Return the class of `std_msgs/msg/String` or `std_msgs/String`."""
    package, *_, name = kind.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise Failure(f"The message type '{kind}' is not in this image") from None


def plain(value):
    """Return a message or a part of one as plain data."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, (bytes, bytearray, array.array)):
        return list(value)
    if hasattr(value, "tolist"):  # numpy's arrays and numbers
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    return value


def fill(message, values):
    """Set a message's fields from plain data."""
    kinds = message.get_fields_and_field_types()
    for name, value in (values or {}).items():
        if name not in kinds:
            known = ", ".join(kinds)
            raise Failure(f"{type(message).__name__} has no field '{name}' (it has: {known})")
        try:
            setattr(message, name, _made(kinds[name], getattr(message, name), value))
        except (AssertionError, TypeError, ValueError) as error:
            raise Failure(f"field '{name}': {error}") from None
    return message


def _made(kind, now, value):
    if hasattr(now, "get_fields_and_field_types"):
        return fill(now, value)
    element = re.sub(r"^sequence<|[,>\[].*$", "", kind)
    if "/" in element:
        return [fill(message_class(element)(), one) for one in value]
    if element in ("float", "double"):
        return [float(v) for v in value] if isinstance(value, list) else float(value)
    return value
