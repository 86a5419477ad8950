from pathlib import Path

from setuptools import find_packages, setup

NAME = "wisar_planner"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", sorted(map(str, Path("launch").glob("*.launch.py")))),
        (f"share/{NAME}/models", sorted(map(str, Path("../../models").glob("sac*.*")))),
        (f"share/{NAME}/config", sorted(map(str, Path("../../config").glob("*.yaml")))),
    ],
    zip_safe=False,
    maintainer="The wisar developers",
    maintainer_email="maintainers@wisar.example",
    description="Probability maps, search planning, evaluation and the nodes around them",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "pdm_server = wisar_planner.nodes.entry:pdm_server",
            "planner = wisar_planner.nodes.entry:planner",
            "mavlink_bridge = wisar_planner.nodes.entry:mavlink_bridge",
            "wisar = wisar_planner.cli.main:main",
        ]
    },
)
