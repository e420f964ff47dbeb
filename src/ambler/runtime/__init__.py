"""How programs run: the table of topics, services and tasks; bus, clocks, nodes, executors, stacks, log."""
