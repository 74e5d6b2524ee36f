"""A node's parameters, read from and set at the node itself."""

from failure import Failure
from rcl_interfaces.msg import ParameterType
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter import get_parameter_value as parsed
from rclpy.parameter_client import AsyncParameterClient
from session import appears, full, session, spin

_KINDS = {
    ParameterType.PARAMETER_BOOL: "Boolean",
    ParameterType.PARAMETER_INTEGER: "Integer",
    ParameterType.PARAMETER_DOUBLE: "Double",
    ParameterType.PARAMETER_STRING: "String",
    ParameterType.PARAMETER_BYTE_ARRAY: "Byte",
    ParameterType.PARAMETER_BOOL_ARRAY: "Boolean",
    ParameterType.PARAMETER_INTEGER_ARRAY: "Integer",
    ParameterType.PARAMETER_DOUBLE_ARRAY: "Double",
    ParameterType.PARAMETER_STRING_ARRAY: "String",
}
_ARRAYS = ParameterType.PARAMETER_BYTE_ARRAY
#: Seconds that a node has for its answer.
_ANSWER = 5.0


def listed(options):
    names = _ask(options, lambda client: client.list_parameters([], 0)).result.names
    for name in sorted(names):
        print(f"  {name}")


def get(options):
    values = _ask(options, lambda client: client.get_parameters([options.name])).values
    if not values or values[0].type == ParameterType.PARAMETER_NOT_SET:
        raise Failure(f"Parameter not set: {options.name}")
    value = values[0]
    form = "values are" if value.type >= _ARRAYS else "value is"
    label = "" if options.hide_type else f"{_KINDS[value.type]} {form}: "
    print(f"{label}{parameter_value_to_python(value)}")


def put(options):
    value = parsed(options.value)
    wanted = Parameter(options.name, value=parameter_value_to_python(value))
    result = _ask(options, lambda client: client.set_parameters([wanted])).results[0]
    if not result.successful:
        raise Failure(f"Setting parameter failed: {result.reason}")
    print("Set parameter successful")


def _ask(options, question):
    """Return the node's answer.

    Raises:
        Failure: the node does not exist, or does not answer.
    """
    name = full(options.node)
    with session(options, wait=False) as node:
        client = AsyncParameterClient(node, name)
        if not appears(node, client.services_are_ready, options):
            raise Failure(f"Node not found: {name}")
        future = question(client)
        if not spin(node, future.done, _ANSWER):
            raise Failure(f"{name} did not answer in {_ANSWER:.0f} s")
        return future.result()
