from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, TimerAction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import ComposableNodeContainer, LoadComposableNodes
from launch_ros.descriptions import ComposableNode


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument("queue", default_value="5"),
            ComposableNodeContainer(
                name="camera_container",
                namespace="",
                package="rclcpp_components",
                executable="component_container_mt",
                composable_node_descriptions=[
                    ComposableNode(
                        package="image_proc",
                        plugin="image_proc::RectifyNode",
                        name="rectify",
                        namespace="camera",
                        parameters=[{"queue_size": LaunchConfiguration("queue")}],
                        remappings=[("image", "image_raw")],
                        extra_arguments=[{"use_intra_process_comms": True}],
                    )
                ],
            ),
            TimerAction(
                period=1.0,
                actions=[
                    LoadComposableNodes(
                        target_container="/rover1/camera_container",
                        composable_node_descriptions=[
                            ComposableNode(
                                package="image_proc", plugin="image_proc::CropDecimateNode"
                            )
                        ],
                    )
                ],
            ),
            LoadComposableNodes(
                target_container="/elsewhere",
                composable_node_descriptions=[ComposableNode(package="p", plugin="p::A", name="a")],
            ),
        ]
    )
