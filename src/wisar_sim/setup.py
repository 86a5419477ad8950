from setuptools import find_packages, setup

NAME = "wisar_sim"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    zip_safe=False,
    maintainer="The wisar developers",
    maintainer_email="maintainers@wisar.example",
    description="The simulated drone and the simulated autopilot",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "sim_drone = wisar_sim.entry:sim_drone",
            "sim_autopilot = wisar_sim.entry:sim_autopilot",
        ]
    },
)
