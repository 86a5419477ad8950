"""Missions and how they reach an autopilot over MAVLink.

`mission` makes missions and `checks` refuses bad ones; `client` is the one object that a node or
a script needs to talk to a vehicle; `flight` adds up what the flight has seen; `files` writes
plans for pilots without ROS. The rest is the protocol: state machines (`upload`, `download`,
`command`, `transfer`) that know neither sockets nor clocks, and the link below them.
"""
