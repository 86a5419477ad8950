"""Map, planner, simulated drone, bridge and simulated autopilot on one map.

    ros2 launch wisar_planner search.launch.py map:=/path/to/map.tif planner:=sac_search
    ros2 launch wisar_planner search.launch.py map:=... connection:=udpin:0.0.0.0:14550 sim:=false
    ros2 launch wisar_planner search.launch.py --show-args

For people with ROS 2 installed; `make demo` does the same without the launch packages.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackagePrefix

from wisar_planner.errors import InvalidInput
from wisar_planner.pdm.gis import load_map
from wisar_planner.planners.registry import planner_names, planner_options

PARAMETERS = Path(get_package_share_directory("wisar_planner"), "config", "search.yaml")
ARGUMENTS = {
    "map": ("", "GeoTIFF, or GeoJSON or YAML mixture; empty: wait for load_pdm"),
    "planner": ("", f"one of {', '.join(planner_names())}; empty: as in params, else sac_search"),
    "swath_radius": ("", "half the width of the strip that is seen, m; empty: as in params"),
    "step_length": ("", "distance between waypoints, m; empty: as in params"),
    "max_distance": ("", "longest path, m; empty: as in params"),
    "connection": (
        "",
        "where the autopilot is: udpin:, udpout:, tcp: or a serial device, as pymavlink has it; "
        "empty: udpout:127.0.0.1:14550 in the simulation, else as in params",
    ),
    "namespace": ("", "namespace of all nodes, one per drone"),
    "sim": ("true", "whether to start the simulated drone and the simulated autopilot"),
    "home": ("", "latitude,longitude of the simulated autopilot; empty: the middle of the map"),
    "speed_up": ("", "of the simulated drone, times real time; empty: as in params"),
    "params": (str(PARAMETERS), "ROS 2 parameter file; the arguments above win over it"),
}


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments, and the processes that follow from them."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            OpaqueFunction(function=processes),
        ]
    )


def processes(context: LaunchContext) -> list[ExecuteProcess]:
    """Return the processes to start; raise InvalidInput where an argument cannot be right."""
    value = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    if value["sim"].lower() not in ("true", "1", "false", "0"):
        raise InvalidInput(f"sim:={value['sim']}: this must be true or false")
    simulated = value["sim"].lower() in ("true", "1")
    map_file = existing_file("map", value["map"])
    parameter_file = existing_file("params", value["params"])
    if value["planner"]:
        planner_options(value["planner"])
    if simulated:
        value["connection"] = value["connection"] or "udpout:127.0.0.1:14550"
        if not value["connection"].startswith("udpout:"):
            raise InvalidInput(
                f"connection:={value['connection']} leads to no simulated autopilot: "
                "add sim:=false, or give udpout:127.0.0.1:PORT"
            )

    def node(package: str, executable: str, *names: str, **parameters: object) -> Node:
        texts = {name: ParameterValue(value[name], value_type=str) for name in names if value[name]}
        return Node(
            package=package,
            executable=executable,
            namespace=value["namespace"],
            parameters=[*filter(None, [parameter_file]), {**texts, **parameters}],
            output="screen",
            on_exit=end_after_mistake,
        )

    lengths = numbers(value, "swath_radius", "step_length", "max_distance")
    started = [
        node("wisar_planner", "pdm_server", map=map_file),
        node("wisar_planner", "planner", "planner", **lengths),
        node("wisar_planner", "mavlink_bridge", "connection"),
    ]
    if simulated:
        home = value["home"] or (middle(map_file) if map_file else "")
        # Not a ROS node: launch's Node would append --ros-args.
        autopilot = ExecuteProcess(
            cmd=[
                PathJoinSubstitution(
                    [FindPackagePrefix("wisar_sim"), "lib", "wisar_sim", "sim_autopilot"]
                ),
                *("--connection", value["connection"].replace("udpout:", "udpin:", 1)),
                # In one word: a latitude south of the equator begins like an option.
                *([f"--home={home}"] if home else []),
            ],
            output="screen",
            on_exit=end_after_mistake,
        )
        started += [node("wisar_sim", "sim_drone", **numbers(value, "speed_up")), autopilot]
    return started


def existing_file(name: str, path: str) -> str:
    """Return the path of an argument's file, "" where none is given."""
    if not path:
        return ""
    file = Path(path).expanduser().absolute()
    if not file.is_file():
        raise InvalidInput(f"{name}:={path}: there is no such file")
    return str(file)


def numbers(value: dict[str, str], *names: str) -> dict[str, float]:
    """Return the numbers among the arguments that are given."""
    found = {}
    for name in filter(value.get, names):
        try:
            found[name] = float(value[name])
        except ValueError:
            raise InvalidInput(f"{name}:={value[name]}: this must be a number") from None
    return found


def middle(map_file: str) -> str:
    """Return "latitude,longitude" of a map's local origin."""
    origin = load_map(map_file).origin
    return f"{origin.latitude:.7f},{origin.longitude:.7f}"


def end_after_mistake(event: ProcessExited, _: LaunchContext) -> Shutdown | None:
    """End the launch where a process has refused its arguments; its own line says why.

    One that fails later takes nothing with it: the bridge follows a flight without the planner.
    """
    if event.returncode == 2:
        return Shutdown(reason=f"{event.process_name} refused its arguments, see its line above")
    return None
