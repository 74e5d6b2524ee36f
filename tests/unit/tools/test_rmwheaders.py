"""The comparison of the layer with ROS 2's headers finds functions and structs that differ."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.rmwheaders import main

pytestmark = pytest.mark.programs

HEADER = """
/* rmw_take(int) */
RMW_PUBLIC
rmw_ret_t
rmw_take(
  const rmw_subscription_t * subscription,
  void * ros_message,
  bool * taken,
  rmw_subscription_allocation_t * allocation);
typedef struct RMW_PUBLIC_TYPE rmw_request_id_s
{
  int8_t writer_guid[16];
  int64_t sequence_number;
} rmw_request_id_t;
typedef struct RMW_PUBLIC_TYPE rmw_service_info_s
{
  rmw_time_point_value_t source_timestamp, received_timestamp;
  rmw_request_id_t request_id;
} rmw_service_info_t;
"""


@pytest.mark.parametrize(
    ("old", "new", "differs"),
    [
        ("", "", ()),
        ("bool * taken,", "", ("rmw_take",)),
        ("void * ros_message,", "size_t ros_message,", ("rmw_take",)),
        (", received_timestamp", "", ("rmw_service_info_t",)),
        ("int64_t seq", "int32_t seq", ("rmw_request_id_t", "rmw_service_info_t")),
    ],
)
def test_what_differs_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, differs: tuple[str, ...]
) -> None:
    """And is a failure; what the headers lack is not."""
    (tmp_path / "rmw").mkdir()
    (tmp_path / "rmw/rmw.h").write_text(HEADER.replace(old, new) if old else HEADER)
    assert main([f"jazzy={tmp_path}"]) == bool(differs)
    rows = [line for line in capsys.readouterr().out.splitlines() if line.endswith("| differs |")]
    assert rows == [f"| {', '.join(f'`{name}`' for name in differs)} | differs |"][: bool(differs)]
