import os
from tempfile import NamedTemporaryFile

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    GroupAction,
    IncludeLaunchDescription,
    OpaqueFunction,
    RegisterEventHandler,
    SetEnvironmentVariable,
    Shutdown,
    TimerAction,
)
from launch.conditions import IfCondition, UnlessCondition
from launch.event_handlers import OnProcessExit, OnProcessStart
from launch.events import Shutdown as ShutdownEvent
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import Command, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node, PushRosNamespace, SetParameter, SetRemap
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

SHARE = get_package_share_directory("rover_bringup")
print("this launch file prints")


def make_planner(context):
    """What only Python can do: a name from an argument, and a file that is made now."""
    count = int(LaunchConfiguration("planners").perform(context))
    with open(os.path.join(SHARE, "config", "planner.yaml")) as file:
        text = file.read().replace("0.5", LaunchConfiguration("speed").perform(context))
    with NamedTemporaryFile("w", suffix=".yaml", delete=False) as made:
        made.write(text)
    return [
        Node(
            package="rover_planner",
            executable="planner",
            name="planner" if number == 0 else f"planner{number}",
            parameters=[made.name],
            arguments=["--log", "a b"],
            ros_arguments=["--log-level", "warn"],
        )
        for number in range(count)
    ]


def generate_launch_description():
    driver = Node(
        package="rover_base",
        executable="driver",
        name="driver",
        respawn=True,
        parameters=[
            {"rate": 10.0, "pid": {"p": 1.5, "gains": [1.0, 2.5]}, "serial": "0042"},
            os.path.join(SHARE, "config", "rover.yaml"),
            {"frame": "odom"},
        ],
        remappings=[("cmd_vel", "/mux/cmd_vel"), ("~/odom", "/odom"), ("scan", "too/late")],
        additional_env={"MAPS": os.path.join(SHARE, "maps")},
    )
    spawn = Node(package="rover_base", executable="spawn.py", arguments=["-x", "1"])
    lifecycle = LifecycleNode(package="rover_base", executable="arm", name="arm", namespace="")
    description = Command(["cat ", PathJoinSubstitution([SHARE, "urdf", "rover.urdf"])])
    camera = os.path.join(os.path.dirname(__file__), "camera.launch.py")
    return LaunchDescription(
        [
            DeclareLaunchArgument("planners", default_value="2"),
            DeclareLaunchArgument("speed", default_value="0.7"),
            DeclareLaunchArgument("sim", default_value="false"),
            SetEnvironmentVariable("RCUTILS_COLORIZED_OUTPUT", "1"),
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                name="state",
                parameters=[{"robot_description": ParameterValue(description, value_type=str)}],
            ),
            GroupAction(
                [
                    PushRosNamespace("rover1"),
                    SetParameter("use_sim_time", True),
                    SetRemap("scan", "front/scan"),
                    driver,
                    spawn,
                    IncludeLaunchDescription(
                        PythonLaunchDescriptionSource(camera),
                        launch_arguments={"queue": "7"}.items(),
                    ),
                    TimerAction(
                        period=5.0,  # when the group has ended, with its namespace
                        actions=[Node(package="rover_base", executable="blink", name="blink")],
                    ),
                ]
            ),
            IncludeLaunchDescription(
                [FindPackageShare("rover_bringup"), "/launch/lights.launch.xml"],
                condition=UnlessCondition(LaunchConfiguration("sim")),
            ),
            Node(
                package="gz",
                executable="bridge",
                condition=IfCondition(LaunchConfiguration("sim")),
            ),
            OpaqueFunction(function=make_planner),
            lifecycle,
            ExecuteProcess(cmd=["python3", "-m", "http.server"], on_exit=Shutdown()),
            ExecuteProcess(cmd=["ros2", "topic", "pub", "/hello", "std_msgs/msg/Empty"]),
            ExecuteProcess(cmd=["echo $HOME | cat"], shell=True, name="home", cwd="/tmp"),
            RegisterEventHandler(
                OnProcessExit(
                    target_action=spawn,
                    on_exit=[Node(package="rover_base", executable="arm_up", name="arm_up")],
                )
            ),
            RegisterEventHandler(OnProcessStart(on_start=lambda event, context: None)),
            RegisterEventHandler(
                OnProcessExit(target_action=driver, on_exit=[EmitEvent(event=ShutdownEvent())])
            ),
            TimerAction(
                period=2.0,
                actions=[
                    Node(package="rover_base", executable="horn", name="horn", prefix="nice -n 5")
                ],
            ),
        ]
    )
