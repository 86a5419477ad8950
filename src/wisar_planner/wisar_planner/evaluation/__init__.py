"""Comparison of planners on the same maps: runs, statistics, tables, figures, benchmarks.

Every module here works on the probability map protocol and the planner registry
alone, so a new kind of map or a new planner needs no change in this package.
"""
