"""Simulated vehicle and autopilot to test the search planner against."""
