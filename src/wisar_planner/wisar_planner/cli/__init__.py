"""The `wisar` command: one module per subcommand, found by `wisar_planner.cli.main`."""
