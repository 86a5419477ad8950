"""Map, planner, simulated drone, bridge and simulated autopilot on one map.

    ros2 launch wisar_planner search.launch.py map:=/path/to/map.tif planner:=sac_search
    ros2 launch wisar_planner search.launch.py map:=... connection:=udpin:0.0.0.0:14550 sim:=false

For people with ROS 2 installed; `make demo` does the same without the launch packages.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackagePrefix, FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Describe the processes and their arguments."""
    arguments = {
        "map": ("", "GeoTIFF, or GeoJSON or YAML mixture; empty: wait for load_pdm"),
        "planner": ("sac_search", "name of the planner"),
        "swath_radius": ("25.0", "half the width of the strip that the camera sees, m"),
        "step_length": ("50.0", "distance between waypoints, m"),
        "max_distance": ("8000.0", "longest path, m"),
        "connection": ("udpout:127.0.0.1:14550", "where the autopilot is"),
        "namespace": ("", "namespace of all nodes, one per drone"),
        "sim": ("true", "whether to start the simulated drone and the simulated autopilot"),
        "home": ("56.79,-5.0", "latitude,longitude of the simulated autopilot"),
        "speed_up": ("10.0", "of the simulated drone, times real time"),
        "params": (
            PathJoinSubstitution([FindPackageShare("wisar_planner"), "config", "search.yaml"]),
            "ROS 2 parameter file; the arguments above win over it",
        ),
    }
    value = {name: LaunchConfiguration(name) for name in arguments}

    def number(name: str) -> ParameterValue:
        return ParameterValue(value[name], value_type=float)

    def text(name: str) -> ParameterValue:
        return ParameterValue(value[name], value_type=str)

    def node(package: str, executable: str, parameters: dict, **more: object) -> Node:
        return Node(
            package=package,
            executable=executable,
            namespace=value["namespace"],
            parameters=[value["params"], parameters],
            output="screen",
            **more,
        )

    simulated = IfCondition(value["sim"])
    lengths = ("swath_radius", "step_length", "max_distance")
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in arguments.items()
            ),
            node("wisar_planner", "pdm_server", {"map": text("map")}),
            node(
                "wisar_planner",
                "planner",
                {"planner": text("planner"), **{name: number(name) for name in lengths}},
            ),
            node("wisar_planner", "mavlink_bridge", {"connection": text("connection")}),
            node("wisar_sim", "sim_drone", {"speed_up": number("speed_up")}, condition=simulated),
            # Not a ROS node: launch's Node would append --ros-args.
            ExecuteProcess(
                cmd=[
                    PathJoinSubstitution(
                        [FindPackagePrefix("wisar_sim"), "lib", "wisar_sim", "sim_autopilot"]
                    ),
                    *("--connection", "udpin:127.0.0.1:14550"),
                    *("--home", value["home"]),
                ],
                output="screen",
                condition=simulated,
            ),
        ]
    )
